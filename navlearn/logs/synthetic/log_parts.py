"""Parts of a simulated log: its IMU table, its thermometer, its metadata."""

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import LogMetadata
from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.figures import SensorGrade
from navlearn.logs.synthetic.inertial_errors import AXES

START_TEMPERATURE = 21.0
"""Of the sensors, °C."""


def imu_table(t: Array, rate: list[Array], force: list[Array], temperature: Array) -> pd.DataFrame:
    """Return an IMU table; rates and forces by axis x, y, z."""
    columns = {"t": t}
    columns |= {f"gyro_{axis}": rate[i] for i, axis in enumerate(AXES)}
    columns |= {f"accel_{axis}": force[i] for i, axis in enumerate(AXES)}
    return pd.DataFrame({**columns, "temperature": temperature})


def thermometer(warm: Array, seed: int) -> Array:
    """Return what the sensors' thermometer reads in steps of 0.1 K, °C."""
    noise = generator(seed, "temperature").standard_normal(warm.size) * 0.05
    return np.round((START_TEMPERATURE + warm + noise) * 10.0) / 10.0


def describe(
    name: str,
    source: str,
    grade: SensorGrade,
    profile: str,
    seed: int,
    lever_arm: tuple[float, float, float],
) -> LogMetadata:
    """Return the metadata of a simulated log."""
    gyro, odometer, gnss = grade.gyro, grade.odometer, grade.gnss
    sensors = {
        "imu": f"simulated grade {grade.name}: {grade.summary}; gyro "
        f"{gyro.angle_random_walk_deg_per_sqrt_h:g} °/√h, scale factor "
        f"{gyro.scale_factor_percent:g} % (1 σ)",
        "odometer": f"simulated: scale factor {odometer.scale_factor_percent:g} % (1 σ), noise "
        f"{odometer.noise:g} m/s, step {odometer.step_kmh:g} km/h",
        "fixes": f"simulated: white noise {gnss.noise:g} m, correlated {gnss.correlated_noise:g} m "
        f"({gnss.correlation_time:g} s), outliers {100.0 * gnss.spike_probability:g} %",
        "reference": "simulation truth",
    }
    return LogMetadata(
        name=name,
        source=source,
        license="Apache-2.0",
        time_scale="seconds of the simulation",
        lever_arm=lever_arm,
        gnss_latency=grade.gnss.latency,
        odometer_latency=grade.odometer.latency,
        interval_means=("imu",),
        sensors=sensors,
        is_truth=True,
        extra={"simulated": True, "profile": profile, "grade": grade.name, "seed": seed},
    )
