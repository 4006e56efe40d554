"""The check of a whole log."""

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.accuracy import check_accuracy
from navlearn.logs.quality.agreement import check_clocks, check_forces, check_speed, check_turns
from navlearn.logs.quality.channels import check_channels
from navlearn.logs.quality.findings import QualityReport, assemble
from navlearn.logs.quality.latency import ordered
from navlearn.logs.quality.timing import check_timing
from navlearn.logs.quality.units import check_units

_CHECKS = (
    check_units,
    check_turns,
    check_speed,
    check_clocks,
    check_forces,
    check_accuracy,
    check_channels,
)


def check_log(log: DriveLog) -> QualityReport:
    """Check a log and measure what it tells about its sensors.

    Times are judged as they were read; every other check sees the rows in order, so that one
    mistake does not hide another. Latitudes in degrees are read as such after being reported.

    Args:
        log: The log.

    Returns:
        Findings and figures; ``report.ok`` is False where something would ruin a result.
    """
    clean = ordered(log)
    parts = [check_timing(log), *(check(clean) for check in _CHECKS)]
    return assemble(log.metadata.name, parts)
