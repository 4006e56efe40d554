"""Replays outages on a drive, causally, and scores what each method made of them.

A method is handed a log in which no fix at or after the outage's start exists, no sensor sample
after its end, and no reference at all; only post-processing methods, which say so, also get what
comes after the end. Leaks are shut out by absence, not by promise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd
from tqdm import tqdm

from navlearn.errors import ConfigError, FilterDivergedError, FitError, LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.acting import verdict_columns
from navlearn.outages.dynamics import classify_outage
from navlearn.outages.known_log import known_log, sees_after, settings_with_sight
from navlearn.outages.metrics import (
    FIGURES,
    check_solution,
    errors_over_time,
    figures,
    road_figures,
)
from navlearn.outages.schedule import Outage, refuse_overlaps
from navlearn.outages.store import SolutionStore, plain
from navlearn.outages.track import Track, track_of


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What a method makes of one outage.

    Attributes:
        table: One row per time through the outage: ``t`` (s), ``lat``, ``lon`` (rad),
            ``height`` (m), ``v_e``, ``v_n`` (m/s), ``azimuth`` (rad); optionally ``std_e``,
            ``std_n`` (m) and ``cov_en`` (m²).
        notes: Plain values worth keeping, such as the verdict of a safeguard.
    """

    table: pd.DataFrame
    notes: Mapping[str, object] = field(default_factory=dict)


class Method(Protocol):
    """Anything that navigates through an outage.

    A method that works in post-processing has an attribute ``sees_after``: for how many seconds
    after the outage's end its log goes on, with fixes. Without it the log ends with the outage.
    """

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the solution through an outage.

        Args:
            log: The drive up to the outage's end, without fixes from its start, without
                reference; see :func:`navlearn.outages.known_log.known_log`.
            outage: The outage.
        """


@runtime_checkable
class BatchMethod(Protocol):
    """A method that can also navigate through several outages at once."""

    def predict_many(self, logs: Sequence[DriveLog], outages: Sequence[Outage]) -> list[Solution]:
        """Return the solutions of several outages, the same as one by one.

        Args:
            logs: One log per outage, as for ``predict``; nothing of one log may be used for
                the outage of another.
            outages: The outages.
        """


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What came of replaying outages.

    Attributes:
        rows: One row per outage and method: the columns of ``outages.csv``.
        solutions: Per method and number of the outage, in order of time from 1.
        errors: Errors over time, under the same keys.
    """

    rows: pd.DataFrame
    solutions: Mapping[tuple[str, int], Solution]
    errors: Mapping[tuple[str, int], pd.DataFrame]


def replay(
    log: DriveLog,
    outages: Sequence[Outage],
    methods: Mapping[str, Method],
    *,
    store: Path | None = None,
    settings: Mapping[str, object] | None = None,
    batched: bool = False,
    progress: bool = True,
) -> Replay:
    """Replay every outage with every method and score the solutions by the reference.

    Args:
        log: The drive, with everything in it; methods see its :func:`known_log` only.
        outages: In order of time, not overlapping.
        methods: By name.
        store: Folder in which finished solutions are kept, so that an interrupted run goes on
            where it stopped.
        settings: Per method, the plain values that it was built from. Needed with ``store``:
            another value, another log or another version makes what is stored void.
        batched: Let methods that offer ``predict_many`` do all their outages at once.
        progress: Show a progress bar.

    Returns:
        Rows, solutions and errors over time. A method that diverges or cannot be fitted has a
        row whose ``failure`` tells why and whose figures are NaN, and no solution.

    Raises:
        ConfigError: Outages overlap, there are no methods or outages, or ``settings`` lacks a
            method though there is a store.
        LogError: An outage lies outside the log.
        ShapeError: A method returns something other than a solution of its outage.
    """
    _check(log, outages, methods)
    track = track_of(log)
    told = settings_with_sight(methods, settings)
    shelf = None if store is None else SolutionStore(store, log, methods, told)
    rows: dict[tuple[str, int], dict[str, object]] = {}
    solutions: dict[tuple[str, int], Solution] = {}
    errors: dict[tuple[str, int], pd.DataFrame] = {}
    with tqdm(total=len(methods) * len(outages), disable=not progress, unit="outage") as bar:
        for name, method in methods.items():
            bar.set_postfix_str(name)
            for k, outcome in _outcomes(name, method, log, outages, shelf, batched):
                key, outage = (name, k + 1), outages[k]
                rows[key] = _row_head(log, name, k + 1, outage, track)
                if isinstance(outcome, str):
                    rows[key]["failure"] = outcome
                else:
                    solutions[key] = outcome
                    rows[key] |= verdict_columns(outcome.notes)
                    errors[key] = errors_over_time(outcome.table, track, outage)
                    rows[key] |= figures(errors[key], track, outage)
                bar.update()
    ordered = [rows[name, k + 1] for name in methods for k in range(len(outages))]
    return Replay(rows=_table(ordered), solutions=solutions, errors=errors)


def join_replays(replays: Sequence[Replay]) -> pd.DataFrame:
    """Return the rows of several drives in one table.

    Args:
        replays: One per drive; the drives' names differ.

    Raises:
        ConfigError: Two of them are of the same drive.
    """
    drives = [drive for one in replays for drive in one.rows["drive"].unique()]
    twice = sorted({drive for drive in drives if drives.count(drive) > 1})
    if twice:
        raise ConfigError(f"replays: the drives {twice} come twice; give each log its own name")
    return pd.concat([one.rows for one in replays], ignore_index=True)


def _outcomes(
    name: str,
    method: Method,
    log: DriveLog,
    outages: Sequence[Outage],
    shelf: SolutionStore | None,
    batched: bool,
) -> Iterator[tuple[int, Solution | str]]:
    """Yield, outage by outage as they get done, the solution or the reason why there is none."""
    todo = []
    for k, outage in enumerate(outages):
        found = None if shelf is None else shelf.load(name, outage)
        if found is None:
            todo.append(k)
        else:
            yield k, Solution(table=found[0], notes=found[1])
    made = _predict_all(method, log, [outages[k] for k in todo], batched)
    for k, outcome in zip(todo, made, strict=True):
        if isinstance(outcome, Solution):
            # As it would come back from the store, so that both are alike.
            table, notes = outcome.table.reset_index(drop=True), plain(outcome.notes, where=name)
            outcome = Solution(table=table, notes=notes)
            if shelf is not None:
                shelf.save(name, outages[k], outcome.table, outcome.notes)
        yield k, outcome


def _predict_all(
    method: Method, log: DriveLog, outages: Sequence[Outage], batched: bool
) -> Iterator[Solution | str]:
    after = sees_after(method)
    if batched and outages and isinstance(method, BatchMethod):
        try:
            logs = [known_log(log, one, after=after) for one in outages]
            made = method.predict_many(logs, outages)
            for solution, outage in zip(made, outages, strict=True):
                check_solution(solution.table, outage)
        except (FilterDivergedError, FitError):
            pass  # one by one, only the outage that fails is lost
        else:
            yield from made
            return
    for outage in outages:
        try:
            solution = method.predict(known_log(log, outage, after=after), outage)
            check_solution(solution.table, outage)
        except (FilterDivergedError, FitError) as error:
            yield str(error)
        else:
            yield solution


def _row_head(
    log: DriveLog, method: str, number: int, outage: Outage, track: Track
) -> dict[str, object]:
    return {
        "drive": log.metadata.name,
        "method": method,
        "outage": number,
        "start_s": outage.start,
        "duration_s": outage.duration,
        "dynamics": classify_outage(track, outage),
        "satellites": len(outage.satellites_visible),
        "satellites_visible": " ".join(outage.satellites_visible),
        "azimuth_judged_by": track.azimuth_source,
        "failure": "",
        **verdict_columns({}),
        **road_figures(track, outage),
    }


def _table(rows: list[dict[str, object]]) -> pd.DataFrame:
    table = pd.DataFrame(rows)
    for name in FIGURES:
        if name not in table.columns:
            table[name] = np.nan
    return table[
        [*(c for c in table.columns if c not in (*FIGURES, "failure")), *FIGURES, "failure"]
    ]


def _check(log: DriveLog, outages: Sequence[Outage], methods: Mapping[str, Method]) -> None:
    if not methods or not outages:
        raise ConfigError(
            f"replay: {len(methods)} methods and {len(outages)} outages; expected at least one each"
        )
    refuse_overlaps(tuple(outages), where=log.metadata.name)
    if log.imu.empty:
        raise LogError(f"{log.metadata.name}: the imu table is empty; nothing to replay")
    first, last = float(log.imu["t"].iloc[0]), float(log.imu["t"].iloc[-1])
    for outage in outages:
        if outage.start < first or outage.end > last:
            raise LogError(
                f"{log.metadata.name}: the outage from {outage.start:g} to {outage.end:g} s lies "
                f"outside the log, which has sensors from {first:g} to {last:g} s"
            )
