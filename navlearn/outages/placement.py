"""Places outages on a drive: where GNSS and reference are good and the car moves.

Starts are looked for on a grid of one second. Whether a start is good is decided by stated
rules alone (:class:`navlearn.outages.schedule.OutageProtocol`); no result of any method is seen.
"""

import numpy as np
from numpy.typing import NDArray

from navlearn.errors import LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages import selection
from navlearn.outages.dynamics import STANDSTILL_SPEED, classify_windows, over_windows
from navlearn.outages.partial import ranges_needed, with_satellites
from navlearn.outages.quality import bad_reference, gaps, within_any
from navlearn.outages.receptions import GOOD_SATELLITES, receptions_of
from navlearn.outages.schedule import (
    UNSCORED,
    Exclusion,
    Outage,
    OutageProtocol,
    Placement,
    refuse_overlaps,
)
from navlearn.outages.track import Array, Track, driven, stood, track_of

GRID = 1.0
"""Starts are tried this many seconds apart."""


def place_outages(protocol: OutageProtocol, log: DriveLog) -> Placement:
    """Place outages on a drive as a protocol says.

    Args:
        protocol: How to place them.
        log: The drive; judged by its reference, or by its own fixes where it has none.

    Returns:
        The outages in order of time, what the car does in each, and what was excluded.

    Raises:
        ConfigError: Listed outages overlap.
        LogError: Satellites are to stay in a log without raw ranges; an outage lies outside the
            log; fewer than asked for fit, and the message says how many do; or too few satellites
            could stay in all of them.
    """
    ranges_needed(protocol, log)
    track = track_of(log)
    begin, end = _span(log, track)
    bad = bad_reference(
        track, protocol.max_reference_interval, protocol.max_reference_slip, protocol.slip_span
    )
    notes = _notes(track)
    if protocol.placement == "listed":
        outages, turned_away = _listed(protocol, log.metadata.name, begin, end, bad)
        excluded = [*bad, *turned_away]
    else:
        outages, more = _searched(protocol, log, track, begin, end, bad)
        excluded, notes = bad, [*notes, *more]
    outages, without, said = with_satellites(protocol, log, track, outages)
    excluded, notes = [*excluded, *without], [*notes, *said]
    if outages:
        starts = np.array([outage.start for outage in outages])
        words = tuple(str(word) for word in classify_windows(track, starts, protocol.duration))
    else:
        words = ()
    return Placement(outages=outages, dynamics=words, excluded=tuple(excluded), notes=tuple(notes))


def _span(log: DriveLog, track: Track) -> tuple[float, float]:
    if log.imu.empty:
        raise LogError(f"{log.metadata.name}: the imu table is empty; no outage can be placed")
    first, last = float(log.imu["t"].iloc[0]), float(log.imu["t"].iloc[-1])
    return max(first, float(track.t[0])), min(last, float(track.t[-1]))


def _listed(
    protocol: OutageProtocol, name: str, begin: float, end: float, bad: list[Exclusion]
) -> tuple[tuple[Outage, ...], list[Exclusion]]:
    asked = tuple(Outage(start, protocol.duration) for start in sorted(protocol.times))
    refuse_overlaps(asked, where=name)
    for outage in asked:
        if outage.start < begin or outage.end > end:
            raise LogError(
                f"{name}: the outage from {outage.start:g} to {outage.end:g} s lies outside the "
                f"log, which has sensors and a reference from {begin:g} to {end:g} s; move "
                "or shorten it"
            )
    kept, excluded = [], []
    for outage in asked:
        reasons = [b.reason for b in bad if outage.start < b.end and outage.end > b.start]
        if reasons:
            excluded.append(Exclusion(outage.start, outage.end, UNSCORED + reasons[0]))
        else:
            kept.append(outage)
    return tuple(kept), excluded


def _searched(
    protocol: OutageProtocol,
    log: DriveLog,
    track: Track,
    begin: float,
    end: float,
    bad: list[Exclusion],
) -> tuple[tuple[Outage, ...], list[str]]:
    starts = np.arange(begin, end - protocol.duration + 1e-9, GRID)
    labels = classify_windows(track, starts, protocol.duration)
    rules = _rules(protocol, log, track, begin, starts, labels, bad)
    good = np.ones(starts.shape, dtype=np.bool_)
    for fulfilled in rules.values():
        good &= fulfilled
    if protocol.placement == "by_dynamics":
        good &= np.isin(labels, protocol.classes)
    separation = protocol.duration + protocol.min_gap
    chosen, missing = _choose(protocol, starts[good], labels[good], separation)
    notes = [f"no {name} outage: the drive has no such stretch" for name in missing]
    if chosen.size < protocol.count and protocol.fewer and chosen.size > 0:
        notes.append(f"{protocol.count} outages were asked for, {chosen.size} fit")
    elif chosen.size < protocol.count:
        raise LogError(_too_few(protocol, log.metadata.name, chosen.size, begin, end, rules))
    return tuple(Outage(float(start), protocol.duration) for start in chosen), notes


def _choose(
    protocol: OutageProtocol, starts: Array, labels: np.ndarray, separation: float
) -> tuple[Array, list[str]]:
    if protocol.placement == "by_dynamics":
        return selection.pick_per_class(
            starts, labels, protocol.classes, separation, protocol.count
        )
    fitting = selection.first_that_fit(starts, separation)
    if fitting.size < protocol.count:
        return fitting, []
    if protocol.placement == "random":
        return selection.draw(starts, separation, protocol.count, protocol.seed), []
    return selection.spread_evenly(starts, separation, protocol.count), []


def _rules(
    protocol: OutageProtocol,
    log: DriveLog,
    track: Track,
    begin: float,
    starts: Array,
    labels: np.ndarray,
    bad: list[Exclusion],
) -> dict[str, NDArray[np.bool_]]:
    ends = starts + protocol.duration
    speed = over_windows(track, driven(track), starts, protocol.duration) / protocol.duration
    wanted_speed = np.where(labels == "stop", 0.5, 1.0) * protocol.min_mean_speed
    moving = track.t - track.t[0] - stood(track, STANDSTILL_SPEED)
    moved = np.interp(starts, track.t, moving)
    fix_t, what = _good_times(log)
    ends_of_log = np.array([min(begin, fix_t[0]) - GRID]) if fix_t.size else np.array([begin])
    sparse = gaps(np.concatenate((ends_of_log, fix_t, ends[-1:] + GRID)), protocol.max_fix_interval)
    bad_times = [(one.start, one.end) for one in bad]
    return {
        f"warm-up of {protocol.warm_up:g} s, {protocol.warm_up_moving:g} s of it moving": (
            (starts >= begin + protocol.warm_up) & (moved >= protocol.warm_up_moving)
        ),
        f"{what} at most {protocol.max_fix_interval:g} s apart": ~within_any(
            starts - protocol.good_before, ends, sparse
        ),
        f"good {track.origin}": ~within_any(starts, ends, bad_times),
        f"mean speed of {protocol.min_mean_speed:g} m/s": speed >= wanted_speed,
    }


def _good_times(log: DriveLog) -> tuple[Array, str]:
    """Return when GNSS told the position, or could have, and what told it."""
    known = log.fixes["lat"].notna() & log.fixes["lon"].notna()
    if known.any() or log.ranges is None:
        return log.fixes.loc[known, "t"].to_numpy(dtype=np.float64), "fixes"
    words = f"receptions of {GOOD_SATELLITES} satellites or more"
    return receptions_of(log.ranges).good_times(), words


def _too_few(
    protocol: OutageProtocol,
    name: str,
    fit: int,
    begin: float,
    end: float,
    rules: dict[str, NDArray[np.bool_]],
) -> str:
    found = "; ".join(
        f"{rule}: {100.0 * fulfilled.mean():.0f} %" if fulfilled.size else f"{rule}: no start"
        for rule, fulfilled in rules.items()
    )
    return (
        f"{name}: {protocol.count} outages of {protocol.duration:g} s were asked for, {fit} fit "
        f"between {begin:g} and {end:g} s with {protocol.min_gap:g} s between them. Share of "
        f"starts that fulfil each rule: {found}. Ask for {max(fit, 1)}, shorten them, or relax "
        "a rule of the protocol"
    )


def _notes(track: Track) -> list[str]:
    notes = []
    if track.origin == "fixes":
        notes.append(
            "the log has no reference: outages are placed and judged by its own GNSS fixes"
        )
    if not np.isfinite(track.v_e + track.v_n).any():
        notes.append("the reference has no velocity: its slips cannot be detected")
    if track.azimuth_source == "course":
        notes.append("azimuth is judged by the course of the reference while it moves")
    if track.azimuth_source == "none":
        notes.append("the reference tells no azimuth: azimuth is not judged")
    return notes
