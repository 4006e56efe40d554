"""Ranges simulated for a recorded drive: semi-synthetic data, and called so.

Motion, sensors and reference stay as recorded; satellites, streets, range errors and the
receiver's clock are drawn. What such a log can tell is how a filter uses ranges and how an error
model helps, not how a real receiver fails among houses.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.range_truth import RangeTruth
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.inverse import Truth
from navlearn.logs.synthetic.ranged_log import with_ranges
from navlearn.logs.synthetic.ranges import simulated_ranges
from navlearn.logs.synthetic.reference_motion import (
    reference_stamps,
    reference_truth,
    required_reference,
)
from navlearn.logs.synthetic.satellite_options import SatelliteOptions, find_satellites

COURSE_SPEED = 1.0
"""Slower than this a course says nothing, m/s."""


class RangedDrive(NamedTuple):
    """A recorded drive with simulated ranges.

    Attributes:
        log: The log.
        truth: True errors of its ranges and its receiver's clock.
    """

    log: DriveLog
    truth: RangeTruth


def with_simulated_ranges(
    log: DriveLog,
    satellites: str | SatelliteOptions = "suburban",
    seed: int = 0,
    *,
    rate_hz: float = 1.0,
) -> RangedDrive:
    """Return a recorded drive with ranges simulated along its reference.

    Where the reference pauses nothing is received; without heights it drives on the ellipsoid.
    Satellites stand where they would at the log's GPS time where that is known. Ranges that the
    log had are replaced, and its fixes, too, where the options want them solved from the ranges.

    Args:
        log: Log with a reference that holds position and velocity, and its angles where the
            metadata state a lever arm.
        satellites: Satellites, streets and receiver, or the name of a preset.
        seed: Seed of every draw, not negative.
        rate_hz: Rate of the receptions, Hz.

    Returns:
        The log, whose name, sensors and ``extra["satellites"]`` say what was done, and the truth.

    Raises:
        LogError: The log has no reference, or it lacks what is needed.
        ConfigError: The rate is not positive, the seed is negative, or no preset has the name.
    """
    if seed < 0:
        raise ConfigError(f"seed: found {seed}, expected zero or more")
    if not 0.0 < rate_hz <= 100.0:
        raise ConfigError(f"rate_hz: found {rate_hz}, expected a rate above 0 and up to 100 Hz")
    options, known = find_satellites(satellites), log.metadata
    if options.gps_time is None and known.gps_time_origin is not None:
        options = replace(options, gps_time=known.gps_time_origin)
    arm = any(known.lever_arm)
    reference = required_reference(log, "ranges are", angles=arm)
    latency = 0.0 if known.latency_removed else known.gnss_latency
    stamps = reference_stamps(reference, rate_hz, latency)
    truth = _steered(reference_truth(log, stamps - latency, arm=arm), log)
    made = simulated_ranges(stamps, truth, options=options, lever_arm=known.lever_arm, seed=seed)
    about = replace(known, name=f"{known.name}_ranges_{seed}")
    how = f"semi-synthetic: simulated along the reference, seed {seed}"
    ranged = with_ranges(replace(log, metadata=about), made, options=options, how=how)
    return RangedDrive(ranged, made.truth)


def _steered(truth: Truth, log: DriveLog) -> Truth:
    """Return the motion with speed and heading, by which streets hide satellites."""
    v_e, v_n = truth.v_l[:, 0], truth.v_l[:, 1]
    speed = np.hypot(v_e, v_n)
    heading = truth.kinematics.azimuth
    if not any(log.metadata.lever_arm):
        heading = _course(v_e, v_n, speed)
    velocity = np.where(np.isfinite(truth.v_l[:, 2:]), truth.v_l[:, 2:], 0.0)
    return replace(
        truth,
        v_l=np.concatenate((truth.v_l[:, :2], velocity), axis=1),
        kinematics=truth.kinematics._replace(azimuth=heading, speed=speed),
    )


def _course(v_e: Array, v_n: Array, speed: Array) -> Array:
    known = np.flatnonzero(speed > COURSE_SPEED)
    if known.size == 0:
        return np.zeros_like(speed)
    # A car that stands looks where it last went, before its first way where that led.
    last = np.searchsorted(known, np.arange(speed.size), side="right") - 1
    at = known[np.maximum(last, 0)]
    return np.asarray(np.arctan2(v_e[at], v_n[at]), dtype=np.float64)
