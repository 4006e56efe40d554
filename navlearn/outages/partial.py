"""Partial outages: which satellites stay through each, by the rule that its protocol states.

The choice looks at geometry when the outage starts, and at which satellites go on being received
through it. The latter is what a schedule may know and no method gets: a satellite that sets behind
the next house would make the outage one with fewer satellites than it is counted as.
"""

import math
from dataclasses import replace

import pandas as pd

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.receptions import Receptions, receptions_of
from navlearn.outages.schedule import UNSCORED, Exclusion, Outage, OutageProtocol
from navlearn.outages.sky import sky_at
from navlearn.outages.track import Track
from navlearn.outages.visible import chosen


def with_satellites(
    protocol: OutageProtocol, log: DriveLog, track: Track, outages: tuple[Outage, ...]
) -> tuple[tuple[Outage, ...], list[Exclusion], list[str]]:
    """Return outages with the satellites that stay through each.

    Args:
        protocol: How many stay, and by which rule.
        log: The drive.
        track: Tells where the car is.
        outages: The outages.

    Returns:
        Those through which enough satellites could stay; the others, each with its reason; and
        what a reader should know: the rule, and what it chose.

    Raises:
        LogError: Satellites are to stay, but the log has no raw ranges, or in no outage enough of
            them could.
    """
    needed, ranges = needed_satellites(protocol), ranges_needed(protocol, log)
    if ranges is None or not outages:
        return outages, [], []
    received = receptions_of(ranges)
    kept, excluded, said = [], list[Exclusion](), list[str]()
    for outage in outages:
        found = _visible(protocol, ranges, track, received, outage, needed)
        if isinstance(found, str):
            reason = f"{UNSCORED}{found}; {needed} are needed"
            excluded.append(Exclusion(outage.start, outage.end, reason))
            continue
        kept.append(replace(outage, satellites_visible=found))
        said.append(f"{outage.start:g} s: {' '.join(found)}")
    if not kept:
        raise LogError(
            f"{log.metadata.name}: no outage has {needed} satellites that could stay: "
            + "; ".join(f"{one.start:g} s: {one.reason}" for one in excluded)
            + ". Ask for fewer, or lower outages.min_tracked or outages.min_elevation_deg"
        )
    return tuple(kept), excluded, [_rule(protocol), *_choice(protocol, said)]


def needed_satellites(protocol: OutageProtocol) -> int:
    """Return how many satellites must be there for an outage to be scored.

    Args:
        protocol: How many stay, and how many could.
    """
    return max(protocol.satellites, protocol.min_satellites)


def ranges_needed(protocol: OutageProtocol, log: DriveLog) -> pd.DataFrame | None:
    """Return the raw ranges by which satellites are chosen, None where none are to stay.

    Args:
        protocol: How many stay.
        log: The drive.

    Raises:
        LogError: Satellites are to stay, but the log has no raw ranges.
    """
    needed = needed_satellites(protocol)
    if needed == 0:
        return None
    if log.ranges is None or log.ranges.empty:
        raise LogError(
            f"{log.metadata.name}: {needed} satellites are to stay through each outage, but the "
            "log has no raw ranges; take a log with a table of ranges, or set "
            "outages.satellites: 0"
        )
    return log.ranges


def _visible(
    protocol: OutageProtocol,
    ranges: pd.DataFrame,
    track: Track,
    received: Receptions,
    outage: Outage,
    needed: int,
) -> tuple[str, ...] | str:
    """Return the satellites that stay through an outage, or why there are too few."""
    last = received.before(outage.start)
    if last is None or outage.start - received.t[last] > protocol.max_fix_interval:
        return f"nothing is received within {protocol.max_fix_interval:g} s before it"
    sky = sky_at(ranges, float(received.t[last]), track)
    share = dict(zip(received.names, received.share(outage.start, outage.end), strict=True))
    could = [
        k
        for k, name in enumerate(sky.names)
        if sky.elevation[k] >= protocol.min_elevation and share[name] >= protocol.min_tracked
    ]
    names = [sky.names[k] for k in could]
    lacking = [name for name in protocol.visible_satellites[:needed] if name not in names]
    if lacking:
        return f"of those listed {', '.join(lacking)} could not stay"
    if len(names) < needed:
        return f"only {len(names)} of {len(sky.names)} satellites could stay"
    return chosen(
        protocol.visible,
        protocol.satellites,
        names,
        sky.unit[could],
        listed=protocol.visible_satellites,
        seed=(protocol.seed, round(1000.0 * outage.start)),
    )


def _rule(protocol: OutageProtocol) -> str:
    how = {
        "highest": "the highest",
        "best_geometry": "those whose ranges tell most of the plane",
        "worst_geometry": "those whose ranges tell least of the plane",
        "random": f"drawn with seed {protocol.seed}",
        "listed": f"the first of {', '.join(protocol.visible_satellites)}",
    }[protocol.visible]
    stay = f"{protocol.satellites} satellite{'' if protocol.satellites == 1 else 's'}"
    return (
        f"through each outage {stay} stay{'s' if protocol.satellites == 1 else ''}, {how} "
        f"(`{protocol.visible}`) of those in the last reception before its start that stand "
        f"{math.degrees(protocol.min_elevation):g}° high or more and are in at least "
        f"{100.0 * protocol.min_tracked:g} % of the receptions through it"
    )


def _choice(protocol: OutageProtocol, said: list[str]) -> list[str]:
    return ["satellites that stay: " + "; ".join(said)] if protocol.satellites else []
