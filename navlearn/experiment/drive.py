"""A recipe's drive: read, checked for its outages, its clocks set right.

Latencies are estimated from what lies before the first scored outage only, once, for every
method alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.range_fixes import with_fixes
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.origin import of_drive
from navlearn.logs.quality import Estimate, gnss_latency, odometer_latency
from navlearn.logs.reading import read_log, read_sensor_truth
from navlearn.logs.resample import ResampleOptions, RissTimeline, riss_timeline
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.logs.synthetic import SimulatedDrive, jaradat2017_scenario, simulate_drive
from navlearn.logs.synthetic.degrade import degrade_gyro, degraded_drive
from navlearn.logs.synthetic.faults import with_faults
from navlearn.logs.synthetic.grades import find_grade
from navlearn.logs.synthetic.semi_real import with_aiding_from_reference
from navlearn.outages.placement import place_outages
from navlearn.outages.schedule import Placement
from navlearn.recipe import Recipe
from navlearn.recipe.fault_section import FaultSection
from navlearn.recipe.log_section import SCENARIO, AidingSection, SimulatedSection
from navlearn.recipe.satellite_section import satellite_options

CLEAR = 3.0
"""A latency is removed where it is this many of its own standard deviations from zero, ..."""

WELL_KNOWN = 0.05
"""... and known to this standard deviation, s: a wrong shift harms more than none."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive ready for an experiment.

    Attributes:
        log: The log with its latencies removed.
        placement: Its outages.
        notes: What was done to its clocks, in words.
    """

    log: DriveLog
    placement: Placement
    notes: tuple[str, ...]


def open_log(recipe: Recipe) -> DriveLog:
    """Return the log that a recipe names.

    Args:
        recipe: The recipe.

    Raises:
        LogNotFoundError: It does not exist.
        LogError: It cannot be used as it is.
    """
    log, added = _own_log(recipe), recipe.log.gyro
    log = log if added is None else degrade_gyro(log, added.grade, added.seed)
    log = log if recipe.log.aiding is None else _aided(log, recipe.log.aiding)
    return log if recipe.log.faults is None else _faulty(log, recipe, recipe.log.faults)


def _own_log(recipe: Recipe) -> DriveLog:
    """Return the log that a recipe names, as it was recorded or simulated."""
    source = recipe.log
    if source.simulated is not None:
        log = _simulated(source.simulated).log
    else:
        log = read_log(_path_of(recipe), format=source.format)
    return log if source.between_s is None else _part(log, *source.between_s)


def _part(log: DriveLog, start: float, stop: float) -> DriveLog:
    """Return a part of a log under a name of its own."""
    part = log.between(start, stop)
    if part.imu.empty:
        first, last = log.imu["t"].iloc[0], log.imu["t"].iloc[-1]
        raise LogError(
            f"{log.metadata.name}: no IMU sample between {start:g} and {stop:g} s; it has some "
            f"from {first:g} to {last:g} s: mend log.between_s"
        )
    name = f"{log.metadata.name}_{start:g}-{stop:g}s"
    # Where it began is no longer its start.
    extra = {**log.metadata.extra, **of_drive(log.metadata)}
    # faults are counted by row of the whole log's fixes
    extra.pop("faults", None)
    return replace(part, metadata=replace(part.metadata, name=name, start=None, extra=extra))


def _simulated(made: SimulatedSection) -> SimulatedDrive:
    if made.profile == SCENARIO:
        return jaradat2017_scenario(made.seed)
    return simulate_drive(
        profile=made.profile,
        grade=made.grade,
        duration=made.duration_s,
        seed=made.seed,
        imu_rate_hz=made.imu_rate_hz,
        satellites=None if made.satellites is None else satellite_options(made.satellites),
    )


def _aided(log: DriveLog, made: AidingSection) -> DriveLog:
    """Return the log with fixes and odometer made from its reference."""
    grade = find_grade(made.grade)
    gnss = grade.gnss
    if made.fix_noise is not None:
        gnss = replace(gnss, noise=made.fix_noise, correlated_noise=0.0, spike_probability=0.0)
    return with_aiding_from_reference(
        log,
        fix_rate_hz=made.fix_rate_hz,
        gnss=gnss,
        odometer_rate_hz=made.odometer_rate_hz,
        odometer=grade.odometer if made.odometer else None,
        lever_arm=log.metadata.lever_arm,
        seed=made.seed,
    )


def _faulty(log: DriveLog, recipe: Recipe, asked: FaultSection) -> DriveLog:
    """Return the log with faults in its fixes, single-point ones where it has no others."""
    if log.reference is None:
        raise LogError(
            f"{log.metadata.name}: faults would be put into the fixes by which this log is judged, "
            "because it has no reference; leave log.faults out"
        )
    return with_faults(with_fixes(log, recipe), asked.options()).log


def sensor_truth_of(recipe: Recipe) -> SensorTruth | None:
    """Return what is known of the gyro of a recipe's log where it was simulated, or spoilt.

    Args:
        recipe: The recipe.

    Raises:
        LogError: It is there and cannot be used.
    """
    added, made = recipe.log.gyro, recipe.log.simulated
    if added is None:
        return (
            read_sensor_truth(_path_of(recipe)) if made is None else _simulated(made).sensor_truth
        )
    log = _own_log(recipe)
    return degraded_drive(log, added.grade, added.seed).truth


def _path_of(recipe: Recipe) -> Path:
    source = recipe.log
    path = source.descriptor if source.descriptor is not None else source.path
    if path is None:
        raise ConfigError(f"recipe {recipe.name}: log names neither a descriptor nor a path")
    return path


def prepare_drive(recipe: Recipe, *, until: float | None = None) -> Drive:
    """Read a recipe's log, place its outages and set its clocks right.

    Args:
        recipe: The recipe.
        until: Latencies are estimated from what lies before this time, s; None stands for the
            start of the first outage.

    Returns:
        The drive.

    Raises:
        LogError: The log cannot be used, or the outages do not fit into it.
    """
    return prepare_log(open_log(recipe), recipe, until=until)


def prepare_log(log: DriveLog, recipe: Recipe, *, until: float | None = None) -> Drive:
    """Place a recipe's outages on a log and set its clocks right.

    Args:
        log: The log, already read.
        recipe: The recipe.
        until: As in :func:`prepare_drive`.

    Raises:
        LogError: The outages do not fit into it.
    """
    log = with_fixes(log, recipe)
    placement = place_outages(recipe.outages.protocol(), log)
    first = min((outage.start for outage in placement.outages), default=np.inf)
    log, notes = set_clocks(log, recipe, first if until is None else until)
    return Drive(log=log, placement=placement, notes=notes)


def set_clocks(log: DriveLog, recipe: Recipe, until: float) -> tuple[DriveLog, tuple[str, ...]]:
    """Return the log with its latencies removed, and what was removed.

    Args:
        log: The log, with its latencies still in its times or already taken off.
        recipe: Its ``calibration`` section tells numbers, or ``estimate``: then what the log's
            descriptor states is taken, and what it does not state is estimated.
        until: Nothing at or after this time is used, s.
    """
    notes, values = [], {}
    for name, asked, estimate in (
        ("gnss_latency", recipe.calibration.gnss_latency, gnss_latency),
        ("odometer_latency", recipe.calibration.odometer_latency, odometer_latency),
    ):
        stated = float(getattr(log.metadata, name))
        if asked != "estimate":
            values[name], how = float(asked), "as the recipe says"
        elif stated != 0.0:
            values[name], how = stated, "as the log's descriptor says"
        else:
            values[name], how = _clear(estimate(log, until=until), until)
        notes.append(f"clocks: {name} {values[name]:+.3f} s: {how}")
    return _without(log, values), tuple(notes)


def _without(log: DriveLog, latencies: Mapping[str, float]) -> DriveLog:
    """Return the log with these latencies removed, whatever of them was removed before."""
    known = log.metadata
    rest = {
        name: value - (float(getattr(known, name)) if known.latency_removed else 0.0)
        for name, value in latencies.items()
    }
    remaining: dict[str, Any] = {**rest, "latency_removed": False}
    removed: dict[str, Any] = {**latencies, "latency_removed": True}
    shifted = without_latency(replace(log, metadata=replace(known, **remaining)))
    return replace(shifted, metadata=replace(known, **removed))


def _clear(found: Estimate | None, until: float) -> tuple[float, str]:
    before = "from the drive" + (f" before {until:.0f} s" if np.isfinite(until) else "")
    if found is None:
        return 0.0, f"it could not be estimated {before}"
    told = f"{found.value:+.3f} ± {found.std:.3f} s, estimated {before}"
    if abs(found.value) < CLEAR * found.std:
        return 0.0, f"{told}, is not clear of zero"
    if found.std > WELL_KNOWN:
        return 0.0, f"{told}, is too uncertain to use"
    return found.value, told


def timeline_of(log: DriveLog, recipe: Recipe) -> RissTimeline:
    """Return a log as the tensors that filters take.

    A drive that is cut at the end of an outage is cut between two odometer samples; the last
    speed is held there for as long as a gap within the drive may be bridged.

    Args:
        log: The log, latencies removed.
        recipe: Its ``mechanization`` section tells rate and dimensions.
    """
    section = recipe.mechanization
    return riss_timeline(log, rate_hz=section.rate_hz, dims=section.dims, options=_RESAMPLING)


_RESAMPLING = ResampleOptions(max_odometer_hold=ResampleOptions.max_odometer_gap)
