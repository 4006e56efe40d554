"""Readings of the odometer and of the GNSS receiver, with their errors."""

import math

import numpy as np
import pandas as pd
import torch

from navlearn import attitude, earth
from navlearn.frames import shift_geodetic
from navlearn.logs.synthetic.draws import Array, gauss_markov, generator
from navlearn.logs.synthetic.figures import GnssGrade, OdometerGrade
from navlearn.logs.synthetic.inertial_errors import quantise
from navlearn.logs.synthetic.inverse import Truth, body_rate

_LEAST_STD = 0.01
_LEAST_VELOCITY_STD = 0.005


def odometer_table(t: Array, speed: Array, *, grade: OdometerGrade, seed: int) -> pd.DataFrame:
    """Return the odometer's samples.

    Args:
        t: Stamps, s, shape (N,).
        speed: True speed when each sample was valid (stamp minus latency), m/s, shape (N,).
        grade: Figures of the speed source.
        seed: Seed of the simulation.
    """
    scale = generator(seed, "odometer/scale").standard_normal() * grade.scale_factor_percent / 100.0
    noise = generator(seed, "odometer/noise").standard_normal(t.size) * grade.noise
    read = np.maximum(speed * (1.0 + scale) + np.where(speed > 0.0, noise, 0.0), 0.0)
    read = np.where(read < grade.dead_speed_kmh / 3.6, 0.0, read)
    return pd.DataFrame({"t": t, "speed": quantise(read, grade.step_kmh / 3.6)})


def antenna(
    truth: Truth, lever_arm: tuple[float, float, float]
) -> tuple[Array, Array, Array, Array]:
    """Return where the antenna is and how it moves.

    Args:
        truth: The car, N times.
        lever_arm: Antenna from the IMU, right, forward, up, m.

    Returns:
        Latitude (rad), longitude (rad), height (m), shape (N,), and velocity (m/s, ENU),
        shape (N, 3).
    """
    k = truth.kinematics
    angles = (torch.from_numpy(a) for a in (k.azimuth, k.pitch, k.roll))
    c_lb = attitude.matrix_from_angles(*angles).numpy()
    arm = np.asarray(lever_arm)
    offset = torch.from_numpy(c_lb @ arm)
    position = (torch.from_numpy(a) for a in (truth.lat, truth.lon, truth.height))
    lat, lon, height = shift_geodetic(*position, *offset.unbind(-1))
    swing = np.einsum("nij,nj->ni", c_lb, np.cross(body_rate(k), arm))
    return lat.numpy(), lon.numpy(), height.numpy(), truth.v_l + swing


def fix_errors(t: Array, *, grade: GnssGrade, seed: int) -> tuple[Array, Array]:
    """Return the errors of position (m) and velocity (m/s), ENU, shape (N, 3) each.

    Args:
        t: Stamps at a uniform interval, s, shape (N,).
        grade: Figures of the receiver.
        seed: Seed of the simulation.
    """
    dt = float(t[1] - t[0]) if t.size > 1 else 1.0
    factors = np.array((1.0, 1.0, grade.vertical_factor))
    white = generator(seed, "gnss/white").standard_normal((t.size, 3)) * grade.noise
    slow = np.stack(
        [
            gauss_markov(
                generator(seed, f"gnss/correlated_{axis}"),
                t.size,
                grade.correlated_noise,
                grade.correlation_time,
                dt,
            )
            for axis in ("e", "n", "u")
        ],
        axis=-1,
    )
    rng = generator(seed, "gnss/spikes")
    hit = rng.random(t.size) < grade.spike_probability
    spikes = np.where(hit[:, None], rng.standard_normal((t.size, 3)) * grade.spike, 0.0)
    velocity = generator(seed, "gnss/velocity").standard_normal((t.size, 3)) * grade.velocity_noise
    return (white + slow + spikes) * factors, velocity * factors


def fix_table(
    t: Array, truth: Truth, *, grade: GnssGrade, lever_arm: tuple[float, float, float], seed: int
) -> pd.DataFrame:
    """Return the receiver's fixes.

    Args:
        t: Stamps, s, shape (N,).
        truth: The car when each fix was valid (stamp minus latency), N times.
        grade: Figures of the receiver; the standard deviations it reports know nothing of
            outliers, as a real receiver's.
        lever_arm: Antenna from the IMU, right, forward, up, m.
        seed: Seed of the simulation.
    """
    lat, lon, height, v = antenna(truth, lever_arm)
    position, velocity = fix_errors(t, grade=grade, seed=seed)
    moved = shift_geodetic(
        *(torch.from_numpy(a) for a in (lat, lon, height)),
        *(torch.from_numpy(np.ascontiguousarray(position[:, i])) for i in range(3)),
    )
    satellites = generator(seed, "gnss/satellites").integers(7, 13, t.size)
    std = max(math.hypot(grade.noise, grade.correlated_noise), _LEAST_STD)
    measured = v + velocity
    return pd.DataFrame(
        {
            "t": t,
            "lat": moved[0].numpy(),
            "lon": moved[1].numpy(),
            "height": moved[2].numpy(),
            "v_e": measured[:, 0],
            "v_n": measured[:, 1],
            "v_u": measured[:, 2],
            "std_e": std,
            "std_n": std,
            "std_u": std * grade.vertical_factor,
            "std_v": max(grade.velocity_noise, _LEAST_VELOCITY_STD),
            "satellites": satellites.astype(np.float64),
        }
    )


def reference_table(truth: Truth) -> pd.DataFrame:
    """Return the truth as a reference table."""
    k = truth.kinematics
    return pd.DataFrame(
        {
            "t": truth.t,
            "lat": truth.lat,
            "lon": truth.lon,
            "height": truth.height,
            "v_e": truth.v_l[:, 0],
            "v_n": truth.v_l[:, 1],
            "v_u": truth.v_l[:, 2],
            "azimuth": attitude.wrap_angle(torch.from_numpy(k.azimuth)).numpy(),
            "pitch": k.pitch,
            "roll": k.roll,
        }
    )


def local_gravity(lat: float, height: float) -> float:
    """Return normal gravity at a place, m/s²."""
    where = torch.tensor([lat, height], dtype=torch.float64)
    return float(earth.normal_gravity(where[0], where[1]))
