"""The check of a whole log."""

from dataclasses import replace

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import check_accuracy
from navlearn.logs.quality.agreement import check_speed, check_turns
from navlearn.logs.quality.channels import check_channels
from navlearn.logs.quality.clocks import check_clocks
from navlearn.logs.quality.consistency import check_consistency
from navlearn.logs.quality.findings import QualityReport, assemble
from navlearn.logs.quality.forces import check_forces
from navlearn.logs.quality.latency import ordered
from navlearn.logs.quality.ranges import check_ranges
from navlearn.logs.quality.timing import check_timing
from navlearn.logs.quality.units import check_units, in_radians

_CHECKS = (
    check_turns,
    check_speed,
    check_clocks,
    check_forces,
    check_accuracy,
    check_consistency,
    check_channels,
)


def check_log(log: DriveLog) -> QualityReport:
    """Check a log and measure what it tells about its sensors.

    Times are judged as they were read; every other check sees the rows in order, so that one
    mistake does not hide another. Positions in degrees are reported, then turned into radians.

    Args:
        log: The log.

    Returns:
        Findings and figures; ``report.ok`` is False where something would ruin a result.
    """
    clean = ordered(log)
    parts = [check_timing(log), check_units(clean)]
    repaired = in_radians(clean)
    parts += [check(repaired) for check in _CHECKS]
    parts.append(check_ranges(replace(repaired, ranges=log.ranges)))
    return assemble(log.metadata.name, parts)
