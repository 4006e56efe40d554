"""Errors of gyros and accelerometers, part by part.

A sensor's error is the sum of a deterministic part, a fixed function of motion and temperature
whose coefficients are drawn once per drive (turn-on bias, scale factor, nonlinearity, cross
axis, g-sensitivity, temperature), and a stochastic part (Gauss–Markov bias, random walk, white
noise); quantisation comes last. [Groves2013] §4.4.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from navlearn.logs.synthetic.draws import Array, gauss_markov, generator, random_walk, white_noise
from navlearn.logs.synthetic.figures import AccelerometerGrade, GyroGrade

STANDARD_GRAVITY = 9.80665
"""m/s² in one g of a data sheet."""

DEG = math.pi / 180.0
DEG_PER_H = DEG / 3600.0
DEG_PER_SQRT_H = DEG / 60.0
MG = 1e-3 * STANDARD_GRAVITY

AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class AxisErrors:
    """The error of one sensor axis, by its parts; N samples.

    Attributes:
        deterministic: Parts that are fixed functions of motion and temperature, shape (N,) each.
        stochastic: Parts that are random processes, shape (N,) each.
        coefficients: What was drawn for the deterministic parts, SI.
        step: Quantisation step, zero for none.
    """

    deterministic: Mapping[str, Array]
    stochastic: Mapping[str, Array]
    coefficients: Mapping[str, float]
    step: float

    def deterministic_total(self) -> Array:
        """Return the sum of the deterministic parts, shape (N,)."""
        total: Array = np.sum(list(self.deterministic.values()), axis=0)
        return total

    def drift(self) -> Array:
        """Return the sum of the slow random parts, all but the white noise, shape (N,)."""
        slow = [part for name, part in self.stochastic.items() if name != "white"]
        total: Array = np.sum(slow, axis=0)
        return total

    def apply(self, ideal: Array) -> Array:
        """Return what the sensor reads where the truth is ``ideal``, shape (N,)."""
        read = ideal + self.deterministic_total() + np.sum(list(self.stochastic.values()), axis=0)
        return quantise(read, self.step)


def quantise(values: Array, step: float) -> Array:
    """Return values rounded to whole steps; a step of zero leaves them alone."""
    return np.round(values / step) * step if step > 0.0 else values


def warming(t: Array, rise: float, time_constant: float) -> Array:
    """Return how much warmer than at t = 0 the sensors are, K, shape (N,)."""
    return rise * -np.expm1(-t / time_constant)


def gyro_errors(
    rate: Array,
    force: Array,
    warm: Array,
    dt: float,
    *,
    grade: GyroGrade,
    seed: int,
    purpose: str = "gyro",
) -> tuple[AxisErrors, AxisErrors, AxisErrors]:
    """Return the errors of a gyro triad on a given motion.

    Args:
        rate: Error-free angular rate, rad/s, shape (N, 3).
        force: Specific force, m/s², shape (N, 3).
        warm: Temperature since the start, K, shape (N,).
        dt: Sampling interval, s.
        grade: Figures of the gyros.
        seed: Seed of the simulation.
        purpose: Name under which the draws are made.

    Returns:
        Errors of the x, y and z gyro.
    """
    return (
        _gyro_axis(0, rate, force, warm, dt, grade, seed, purpose),
        _gyro_axis(1, rate, force, warm, dt, grade, seed, purpose),
        _gyro_axis(2, rate, force, warm, dt, grade, seed, purpose),
    )


def _gyro_axis(
    axis: int,
    rate: Array,
    force: Array,
    warm: Array,
    dt: float,
    grade: GyroGrade,
    seed: int,
    purpose: str,
) -> AxisErrors:
    name = f"{purpose}_{AXES[axis]}"
    per_g = grade.g_sensitivity_deg_per_s_per_g * DEG / STANDARD_GRAVITY
    drawn = _draw(
        seed,
        name,
        {
            "turn_on_bias": grade.bias_deg_per_s * DEG,
            "scale_factor": grade.scale_factor_percent / 100.0,
            "even": grade.even_percent / 100.0,
            "odd": grade.odd_percent / 100.0,
            "cross_first": grade.cross_axis_percent / 100.0,
            "cross_second": grade.cross_axis_percent / 100.0,
            "g_sensitivity_x": per_g,
            "g_sensitivity_y": per_g,
            "temperature": grade.temperature_deg_per_s_per_k * DEG,
        },
    )
    first, second = (a for a in range(3) if a != axis)
    own = rate[:, axis]
    deterministic = {
        "turn_on_bias": np.full(own.size, drawn["turn_on_bias"]),
        "scale_factor": drawn["scale_factor"] * own,
        "even": drawn["even"] * np.abs(own),
        "odd": drawn["odd"] * own * np.abs(own),
        "cross_axis": drawn["cross_first"] * rate[:, first]
        + drawn["cross_second"] * rate[:, second],
        "g_sensitivity": drawn["g_sensitivity_x"] * force[:, 0]
        + drawn["g_sensitivity_y"] * force[:, 1],
        "temperature": drawn["temperature"] * warm,
    }
    stochastic = _processes(
        seed,
        name,
        own.size,
        dt,
        instability=grade.bias_instability_deg_per_h * DEG_PER_H,
        correlation_time=grade.correlation_time,
        walk=grade.rate_random_walk_deg_per_h_per_sqrt_h * DEG_PER_H / 60.0,
        white=grade.angle_random_walk_deg_per_sqrt_h * DEG_PER_SQRT_H,
    )
    return AxisErrors(
        deterministic=deterministic,
        stochastic=stochastic,
        coefficients=drawn,
        step=grade.step_deg_per_s * DEG,
    )


def accelerometer_errors(
    force: Array, warm: Array, dt: float, *, grade: AccelerometerGrade, seed: int
) -> tuple[AxisErrors, AxisErrors, AxisErrors]:
    """Return the errors of an accelerometer triad on a given motion.

    Args:
        force: Error-free specific force, m/s², shape (N, 3).
        warm: Temperature since the start, K, shape (N,).
        dt: Sampling interval, s.
        grade: Figures of the accelerometers.
        seed: Seed of the simulation.

    Returns:
        Errors of the x, y and z accelerometer.
    """
    return (
        _accelerometer_axis(0, force, warm, dt, grade, seed),
        _accelerometer_axis(1, force, warm, dt, grade, seed),
        _accelerometer_axis(2, force, warm, dt, grade, seed),
    )


def _accelerometer_axis(
    axis: int, force: Array, warm: Array, dt: float, grade: AccelerometerGrade, seed: int
) -> AxisErrors:
    name = f"accel_{AXES[axis]}"
    drawn = _draw(
        seed,
        name,
        {
            "turn_on_bias": grade.bias_mg * MG,
            "scale_factor": grade.scale_factor_percent / 100.0,
            "quadratic": grade.quadratic_mg_per_g2 * MG / STANDARD_GRAVITY**2,
            "cross_first": grade.cross_axis_percent / 100.0,
            "cross_second": grade.cross_axis_percent / 100.0,
            "temperature": grade.temperature_mg_per_k * MG,
        },
    )
    first, second = (a for a in range(3) if a != axis)
    own = force[:, axis]
    deterministic = {
        "turn_on_bias": np.full(own.size, drawn["turn_on_bias"]),
        "scale_factor": drawn["scale_factor"] * own,
        "quadratic": drawn["quadratic"] * own**2,
        "cross_axis": drawn["cross_first"] * force[:, first]
        + drawn["cross_second"] * force[:, second],
        "temperature": drawn["temperature"] * warm,
    }
    stochastic = _processes(
        seed,
        name,
        own.size,
        dt,
        instability=grade.bias_instability_mg * MG,
        correlation_time=grade.correlation_time,
        walk=grade.random_walk_mg_per_sqrt_h * MG / 60.0,
        white=grade.velocity_random_walk_m_per_s_per_sqrt_h / 60.0,
    )
    return AxisErrors(
        deterministic=deterministic,
        stochastic=stochastic,
        coefficients=drawn,
        step=grade.step_mg * MG,
    )


def _draw(seed: int, name: str, deviations: Mapping[str, float]) -> dict[str, float]:
    rng = generator(seed, f"{name}/coefficients")
    return {key: float(rng.standard_normal() * std) for key, std in deviations.items()}


def _processes(
    seed: int,
    name: str,
    count: int,
    dt: float,
    *,
    instability: float,
    correlation_time: float,
    walk: float,
    white: float,
) -> dict[str, Array]:
    return {
        "gauss_markov": gauss_markov(
            generator(seed, f"{name}/gauss_markov"), count, instability, correlation_time, dt
        ),
        "random_walk": random_walk(generator(seed, f"{name}/random_walk"), count, walk, dt),
        "white": white_noise(generator(seed, f"{name}/white"), count, white, dt),
    }
