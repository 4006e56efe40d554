"""A stated synthetic gyro error on a real log: semi-synthetic data, and called so."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import of_drive
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.figures import SensorGrade
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.inertial_errors import AXES, gyro_errors, warming
from navlearn.logs.synthetic.log_parts import START_TEMPERATURE, thermometer


class DegradedDrive(NamedTuple):
    """A real drive with a synthetic gyro error.

    Attributes:
        log: The degraded log.
        truth: The drive's own gyro and the parts of what was added to it.
    """

    log: DriveLog
    truth: SensorTruth


def degrade_gyro(log: DriveLog, grade: str | SensorGrade = "mems_l", seed: int = 0) -> DriveLog:
    """Return the log with the gyro error of a grade added to its own gyros.

    The log's gyro stands for the true rate and its accelerometer for the true specific force;
    g-sensitivity is left out where there is none, cross axis where there is only one gyro.
    Without a temperature, the simulated one that the error follows is added.

    Args:
        log: Log with a gyro clearly better than the grade.
        grade: Name of a sensor grade, or a grade; its gyro figures are used.
        seed: Seed of every draw.

    Returns:
        The degraded log; its name, sensors and ``extra["semi_synthetic"]`` say what was done.
        :func:`degraded_drive` also tells what was added.

    Raises:
        LogError: The z gyro has values that are not finite.
        ConfigError: No such grade.
    """
    return degraded_drive(log, grade, seed).log


def degraded_drive(
    log: DriveLog, grade: str | SensorGrade = "mems_l", seed: int = 0
) -> DegradedDrive:
    """Return what :func:`degrade_gyro` returns, and what an oracle may know of it.

    Args:
        log: Log with a gyro clearly better than the grade.
        grade: Name of a sensor grade, or a grade; its gyro figures are used.
        seed: Seed of every draw.

    Raises:
        LogError: The z gyro has values that are not finite.
        ConfigError: No such grade.
    """
    figures = find_grade(grade)
    imu = log.imu.copy()
    t = imu["t"].to_numpy(dtype=np.float64)
    rate, force = _triad(log, "gyro"), _triad(log, "accel")
    if not np.isfinite(imu["gyro_z"].to_numpy()).all():
        raise LogError(
            f"{log.metadata.name}: gyro_z has values that are not finite; resample or cut the log "
            "before its gyro is degraded"
        )
    warm = _warm(log, figures)
    errors = gyro_errors(
        rate,
        force,
        warm,
        float(np.median(np.diff(t))),
        grade=figures.gyro,
        seed=seed,
        purpose="degrade_gyro",
    )
    for i, axis in enumerate(AXES):
        if f"gyro_{axis}" in imu:
            imu[f"gyro_{axis}"] = errors[i].apply(imu[f"gyro_{axis}"].to_numpy(dtype=np.float64))
    if "temperature" not in imu and figures.warming_k > 0.0:
        imu["temperature"] = thermometer(warm, seed)
    note = f"semi-synthetic: gyro error of grade {figures.name}, seed {seed}, added"
    before = log.metadata.sensors.get("imu", "")
    stated = {"grade": figures.name, "seed": seed, **errors[2].coefficients}
    metadata = replace(
        log.metadata,
        name=f"{log.metadata.name}_{figures.name}_{seed}",
        sensors={**log.metadata.sensors, "imu": f"{before}; {note}" if before else note},
        extra={**log.metadata.extra, **of_drive(log.metadata), "semi_synthetic": stated},
    )
    truth = SensorTruth(
        t=t,
        yaw_rate=rate[:, 2],
        gyro_error=errors[2].deterministic_total(),
        gyro_drift=errors[2].drift(),
    )
    return DegradedDrive(replace(log, imu=imu, metadata=metadata), truth)


def _triad(log: DriveLog, kind: str) -> Array:
    count = len(log.imu)
    columns = [
        np.nan_to_num(log.imu[f"{kind}_{axis}"].to_numpy(dtype=np.float64))
        if f"{kind}_{axis}" in log.imu
        else np.zeros(count)
        for axis in AXES
    ]
    return np.stack(columns, axis=-1)


def _warm(log: DriveLog, grade: SensorGrade) -> Array:
    if "temperature" in log.imu:
        read = log.imu["temperature"].interpolate(limit_direction="both").to_numpy(np.float64)
        if np.isfinite(read).all():
            return np.asarray(read - START_TEMPERATURE, dtype=np.float64)
    t = log.imu["t"].to_numpy(dtype=np.float64)
    return warming(t - t[0], grade.warming_k, grade.warming_time)
