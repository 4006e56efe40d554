"""What a drive's worst fixes do to a filter, behind every way to test fixes.

Which fixes are worst is told by the reference, for judging alone: no way and no limit knows it.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import timeline_of
from navlearn.experiment.gated_run import GatedRun, gated_run
from navlearn.fusion.gate_options import GateOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.refused_fixes import fix_errors, nearest_rows
from navlearn.outages.track import Array, track_of
from navlearn.recipe import Recipe

AFTER: Final = 10.0
"""For how long after a worst fix positions are judged with it, s."""


def worst_fixes(log: DriveLog, count: int, *, since: float = -np.inf) -> pd.DataFrame:
    """Return the fixes that are farthest off the reference, no two within :data:`AFTER`.

    Args:
        log: The drive.
        count: How many.
        since: None before this time is asked for, s.

    Returns:
        In order of time: ``t`` (s), ``fix_error`` (horizontal, m) and ``stated`` (horizontal
        standard deviation that the receiver states, m, NaN where it states none).

    Raises:
        ConfigError: The drive has not so many fixes that can be judged.
    """
    fixes = log.fixes.dropna(subset=["lat", "lon"])
    fixes = fixes[fixes["t"] >= since].reset_index(drop=True)
    t = fixes["t"].to_numpy(np.float64)
    off = fix_errors(t, fixes, track_of(log))
    chosen: list[int] = []
    judged = np.flatnonzero(np.isfinite(off))
    for k in judged[np.argsort(-off[judged], kind="stable")]:
        if len(chosen) < count and all(abs(t[k] - t[other]) > AFTER for other in chosen):
            chosen.append(int(k))
    if len(chosen) < count:
        raise ConfigError(
            f"{log.metadata.name}: {count} worst fixes asked for, {len(chosen)} can be judged"
        )
    at = np.sort(chosen)
    stated = np.full(at.shape, np.nan)
    if {"std_e", "std_n"} <= set(fixes.columns):
        stated = np.sqrt(0.5 * (fixes["std_e"] ** 2 + fixes["std_n"] ** 2)).to_numpy()[at]
    return pd.DataFrame({"t": t[at], "fix_error": off[at], "stated": stated})


def gated_runs(
    log: DriveLog, recipe: Recipe, ways: Mapping[str, GateOptions]
) -> dict[str, GatedRun]:
    """Return the runs of a recipe's filter over a drive behind every gate.

    Args:
        log: The drive, latencies removed.
        recipe: Tells the filter but for its gate.
        ways: Gates by name.
    """
    line, options = timeline_of(log, recipe), filter_options(recipe, "ekf", log)
    return {way: gated_run(log, line, gate, options) for way, gate in ways.items()}


def through_worst(worst: pd.DataFrame, runs: Mapping[str, GatedRun]) -> pd.DataFrame:
    """Return what became of the worst fixes, and of positions with and after them.

    Args:
        worst: What :func:`worst_fixes` returned.
        runs: By way.

    Returns:
        A row per fix and way: ``t``, ``fix_error``, ``stated``, ``way``, ``caught`` (refused, or
        taken with less than half its weight), ``error`` (m, of the filter at the fix) and
        ``largest`` (m, until :data:`AFTER` later).
    """
    rows = []
    for _, fix in worst.iterrows():
        start = float(fix["t"])
        for way, run in runs.items():
            own, off = _channels(run.errors)
            through = (own >= start - 1e-6) & (own <= start + AFTER)
            at = nearest_rows(np.array([start]), run.fixes["t"].to_numpy(np.float64))[0]
            rows.append(
                {
                    **fix,
                    "way": way,
                    "caught": bool(run.fixes["caught"].iloc[at]) if at >= 0 else False,
                    "error": float(np.interp(start, own, off)),
                    "largest": float(off[through].max()) if through.any() else np.nan,
                }
            )
    return pd.DataFrame(rows)


def drive_figures(worst: pd.DataFrame, runs: Mapping[str, GatedRun]) -> pd.DataFrame:
    """Return what each way gives through the worst fixes and over the whole drive.

    Args:
        worst: What :func:`worst_fixes` returned.
        runs: By way.

    Returns:
        A row per way: the worst fixes ``caught``; RMS, 95 % and largest error (m) from the worst
        fixes until :data:`AFTER` later, and over the whole drive; fixes caught in all.
    """
    rows = []
    for way, run in runs.items():
        own, off = _channels(run.errors)
        near = np.zeros(own.shape, dtype=np.bool_)
        for start in worst["t"]:
            near |= (own >= start - 1e-6) & (own <= start + AFTER)
        at = nearest_rows(worst["t"].to_numpy(np.float64), run.fixes["t"].to_numpy(np.float64))
        caught = run.fixes["caught"].to_numpy()
        rows.append(
            {
                "way": way,
                "worst caught": f"{int(caught[at[at >= 0]].sum())}/{len(worst)}",
                **{f"near {name}": value for name, value in _figures(off[near]).items()},
                **_figures(off),
                "caught in all": int(caught.sum()),
                "of fixes": len(caught),
            }
        )
    return pd.DataFrame(rows)


def _channels(errors: pd.DataFrame) -> tuple[Array, Array]:
    return errors["t"].to_numpy(np.float64), errors["horizontal"].to_numpy(np.float64)


def _figures(off: Array) -> dict[str, float]:
    return {
        "RMS": float(np.sqrt(np.mean(off**2))),
        "95 %": float(np.quantile(off, 0.95)),
        "largest": float(off.max()),
    }
