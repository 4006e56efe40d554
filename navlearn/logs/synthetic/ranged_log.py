"""A log with simulated ranges, and the fixes that follow from them."""

from dataclasses import asdict, replace

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.single_point_fixes import with_single_point_fixes
from navlearn.logs.synthetic.ranges import CORRECTIONS, SimulatedRanges
from navlearn.logs.synthetic.satellite_options import SatelliteOptions


def with_ranges(
    log: DriveLog, made: SimulatedRanges, *, options: SatelliteOptions, how: str = "simulated"
) -> DriveLog:
    """Return a log with simulated ranges and, where the options say so, their solutions as fixes.

    Args:
        log: The log.
        made: Its ranges.
        options: What they were made with; stated in ``extra["satellites"]``.
        how: What the metadata call them.

    Raises:
        LogError: The fixes are to be solved from the ranges, and no reception can be.
    """
    parts = (
        f"thermal {options.thermal:g} m",
        f"ionosphere {options.ionosphere:g} m",
        f"orbit {options.orbit:g} m",
        f"multipath {options.multipath:g} m",
        f"reflections {options.reflections_per_hour:g} 1/h",
        f"canyons {100.0 * options.canyon_share:g} %",
    )
    about = replace(
        log.metadata,
        range_corrections=CORRECTIONS,
        klobuchar=(),
        gps_time_origin=made.gps_time_origin,
        sensors={
            **log.metadata.sensors,
            "ranges": f"{how}: systems {'/'.join(options.systems)}; {', '.join(parts)}",
        },
        extra={**log.metadata.extra, "satellites": _plain(options)},
    )
    ranged = replace(log, ranges=made.table, metadata=about)
    if options.fixes == "drawn":
        return ranged
    told = {**about.sensors, "fixes": f"{how}: single-point solutions of the ranges"}
    try:
        return with_single_point_fixes(replace(ranged, metadata=replace(about, sensors=told)))
    except LogError as problem:
        raise LogError(
            f"{problem}; simulated satellites: receive more of them (lowest_deg, systems), or set "
            "fixes: drawn"
        ) from None


def _plain(options: SatelliteOptions) -> dict[str, object]:
    # As JSON gives them back.
    return {**asdict(options), "systems": list(options.systems)}
