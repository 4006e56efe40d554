"""Fixes and odometer made from a drive's reference: semi-real data, and called so.

For drives that were published with a good IMU and its solution but with neither a receiver's
fixes nor an odometer. Motion, IMU and reference stay as recorded; only the aiding is drawn, with
the figures of a sensor grade. What such a log can tell is how an IMU coasts and how an error
model helps, not how a real receiver fails among houses.
"""

from dataclasses import asdict, replace

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.logs.assemble import without_rows
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.origin import of_drive
from navlearn.logs.synthetic.aiding import fix_table, odometer_table
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.figures import GnssGrade, OdometerGrade
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.reference_motion import (
    place_at,
    reference_stamps,
    reference_truth,
    required_reference,
)

STANDING = 0.05
"""Slower than this the car stands and its wheels do not turn, m/s."""

_MADE = ("fixes", "odometer")


def with_aiding_from_reference(
    log: DriveLog,
    *,
    fix_rate_hz: float = 1.0,
    gnss: str | GnssGrade = "mems_m",
    odometer_rate_hz: float = 10.0,
    odometer: str | OdometerGrade | None = "mems_m",
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
) -> DriveLog:
    """Return the log with fixes and odometer made from its reference.

    Position, velocity and speed are those of the reference at the time when a sample was valid,
    with the errors of the grades added; where the reference pauses or lacks a value there is no
    sample. The odometer reads the velocity along the reference's forward axis, never negative.
    Fixes and odometer that the log had are replaced.

    Args:
        log: Log with a reference that holds position and velocity.
        fix_rate_hz: Rate of the fixes, Hz.
        gnss: Figures of the receiver, or the name of a sensor grade whose are taken.
        odometer_rate_hz: Rate of the odometer, Hz.
        odometer: Figures of the odometer, the name of a sensor grade, or None for none.
        lever_arm: Antenna from the reference's point, right, forward, up, m; stated in the
            metadata.
        seed: Seed of every draw.

    Returns:
        The log; its name, sensors and ``extra["semi_real"]`` say what was done.

    Raises:
        LogError: The log has no reference, or it lacks what is needed.
        ConfigError: A rate is not positive, the seed is negative, or a grade is unknown.
    """
    _check(seed, fix_rate_hz=fix_rate_hz, odometer_rate_hz=odometer_rate_hz)
    receiver = find_grade(gnss).gnss if isinstance(gnss, str) else gnss
    wheels = find_grade(odometer).odometer if isinstance(odometer, str) else odometer
    reference = required_reference(log, "aiding is", angles=any(lever_arm))
    stamps = reference_stamps(reference, fix_rate_hz, receiver.latency)
    truth = reference_truth(log, stamps - receiver.latency, arm=any(lever_arm))
    fixes = fix_table(stamps, truth, grade=receiver, lever_arm=lever_arm, seed=seed)
    lacking = [name for name in ("height", "v_u") if name not in reference]
    speeds = without_rows("odometer")
    if wheels is not None:
        stamps = reference_stamps(reference, odometer_rate_hz, wheels.latency)
        speed = _forward_speed(place_at(log, stamps - wheels.latency))
        speeds = odometer_table(stamps, speed, grade=wheels, seed=seed)
    stated = {
        "seed": seed,
        "fix_rate_hz": fix_rate_hz,
        "gnss": asdict(receiver),
        "odometer_rate_hz": odometer_rate_hz if wheels is not None else None,
        "odometer": asdict(wheels) if wheels is not None else None,
    }
    return replace(
        log,
        fixes=fixes.drop(columns=lacking).dropna(ignore_index=True),
        odometer=speeds.dropna(ignore_index=True),
        metadata=_metadata(log.metadata, receiver, wheels, stated, lever_arm),
    )


def _check(seed: int, **rates: float) -> None:
    if seed < 0:
        raise ConfigError(f"seed: found {seed}, expected zero or more")
    for name, value in rates.items():
        if not 0.0 < value <= 1000.0:
            raise ConfigError(f"{name}: found {value}, expected a rate above 0 and up to 1000 Hz")


def _forward_speed(place: pd.DataFrame) -> Array:
    azimuth, v_e, v_n = (place[name].to_numpy(np.float64) for name in ("azimuth", "v_e", "v_n"))
    pitch, v_u = (place[name].fillna(0.0).to_numpy(np.float64) for name in ("pitch", "v_u"))
    level = v_e * np.sin(azimuth) + v_n * np.cos(azimuth)
    forward = level * np.cos(pitch) + v_u * np.sin(pitch)
    speed = np.where(np.isfinite(forward), forward, np.hypot(v_e, v_n))
    # A gap stays NaN.
    return np.where(speed < STANDING, 0.0, speed)


def _metadata(
    known: LogMetadata,
    gnss: GnssGrade,
    odometer: OdometerGrade | None,
    stated: dict[str, object],
    lever_arm: tuple[float, float, float],
) -> LogMetadata:
    made = f"semi-real: made from the reference, seed {stated['seed']}"
    sensors = {
        **known.sensors,
        "fixes": f"{made}; white noise {gnss.noise:g} m, correlated {gnss.correlated_noise:g} m "
        f"({gnss.correlation_time:g} s), velocity {gnss.velocity_noise:g} m/s",
        "odometer": "none"
        if odometer is None
        else f"{made}; scale factor {odometer.scale_factor_percent:g} % (1 σ), noise "
        f"{odometer.noise:g} m/s, step {odometer.step_kmh:g} km/h",
    }
    files = known.extra.get("files")
    kept = {k: v for k, v in files.items() if k not in _MADE} if isinstance(files, dict) else {}
    return replace(
        known,
        name=f"{known.name}_semi_real_{stated['seed']}",
        lever_arm=lever_arm,
        gnss_latency=gnss.latency,
        odometer_latency=0.0 if odometer is None else odometer.latency,
        latency_removed=False,
        interval_means=tuple(name for name in known.interval_means if name not in _MADE),
        sensors=sensors,
        extra={**known.extra, **of_drive(known), "files": kept, "semi_real": stated},
    )
