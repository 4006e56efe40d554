"""Says in plain words what a sweep found: per class who helps, who is harmless, who harms."""

import math
from collections.abc import Mapping

import pandas as pd

from navlearn.outages.cells import Cell, cell_of, cells_of, conditions
from navlearn.outages.leaks import leak_warnings
from navlearn.outages.naming import counted, with_unit
from navlearn.outages.oracle_share import why_no_share
from navlearn.outages.roles import ORACLE, from_paper, having, real_time
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.satellite_wording import satellite_meaning
from navlearn.outages.statistics import MARGIN_PERCENT
from navlearn.outages.sweep_summary import SweepSummary
from navlearn.outages.wording import percent

GROUPS = ("helps", "harmless", "harms", "no evidence")


def sweep_meaning(summary: SweepSummary, table: pd.DataFrame) -> list[str]:
    """Return the paragraphs of "What this means": warnings, then class by class.

    Args:
        summary: The sweep.
        table: What :func:`~navlearn.outages.sweep_tables.sweep_table` made of its rows.
    """
    return [
        *sweep_warnings(summary),
        *satellite_meaning(summary),
        *_classes(summary, table),
        *_papers(summary.methods, table),
        *_safeguard(summary.methods, table),
        *_failures(table),
    ]


def sweep_warnings(summary: SweepSummary) -> list[str]:
    """Return a warning for every gain of the sweep that cannot be true.

    Args:
        summary: The sweep.
    """
    told = conditions(summary.rows)
    return [
        line
        for cell, part in cells_of(summary.rows)
        for line in leak_warnings(
            part,
            real_time(summary.methods),
            metric=summary.metric,
            resamples=summary.resamples,
            seed=summary.bootstrap_seed,
            where=f"Class {cell.gyro_class}, {told[cell]}: ",
        )
    ]


def _classes(summary: SweepSummary, table: pd.DataFrame) -> list[str]:
    lines, told = [], conditions(table)
    for cell, part in cells_of(table):
        base = part[part["method"] == summary.baseline].iloc[0]
        words = summary.classes.get(cell.gyro_class, "")
        off_by = with_unit(base["mean"], summary.metric)
        lines.append(
            f"**Class {cell.gyro_class}{f' ({words})' if words else ''}, {told[cell]}** "
            f"({counted(base['outages'], 'outage')} of {counted(base['drives'], 'drive')}; "
            f"**{summary.baseline}** is off by {off_by} on the mean): "
            + "; ".join(_groups(part[part["role"] == "learned"]))
            + "."
            + _bounds(part)
        )
    return lines


def _groups(learned: pd.DataFrame) -> list[str]:
    found = []
    for verdict in GROUPS:
        mine = learned[learned["verdict"] == verdict]
        mine = mine.sort_values("improvement_percent", ascending=False, kind="stable")
        names = ", ".join(_gain(line) for _, line in mine.iterrows())
        found.append(f"{verdict}: {names or 'none'}")
    return found


def _gain(line: "pd.Series") -> str:
    if line["ties"] == line["pairs"] and line["failed_alone"] == 0:
        return f"**{line['method']}** (never acted)"
    behind = []
    if math.isfinite(line["low_percent"]):
        low = percent(line["low_percent"]).removesuffix(" %")
        behind.append(f"{low} to {percent(line['high_percent'])}")
    if line["oracle_share_percent"] > 0.0:
        behind.append(f"{line['oracle_share_percent']:.0f} % of the oracle's gain")
    shown = f" ({'; '.join(behind)})" if behind else ""
    return f"**{line['method']}** {percent(line['improvement_percent'])}{shown}"


def _bounds(part: pd.DataFrame) -> str:
    said = []
    for role, words in (("post-processing", "With what came after, "), ("oracle", "Bounds: ")):
        mine = part[(part["role"] == role) & part["improvement_percent"].notna()]
        gains = ", ".join(
            f"{line['method']} {percent(line['improvement_percent'])}"
            for _, line in mine.iterrows()
        )
        if gains:
            said.append(f" {words}{gains}.")
    oracle = part[part["method"] == ORACLE]
    if (oracle["verdict"] != "helps").any():
        one = oracle.iloc[0]
        why = why_no_share(int(one["units"]), int(one["failed_alone"]))
        said.append(f" {why[0].upper()}{why[1:]}, so there are no shares of it.")
    return "".join(said)


def _papers(methods: Mapping[str, MethodSummary], table: pd.DataFrame) -> list[str]:
    lines, told = [], conditions(table)
    for name in having(methods, "learned"):
        mine = table[(table["method"] == name) & table["verdict"].notna()]
        if not from_paper(name) or mine.empty:
            continue
        guarded = methods[name].guarded
        what, how = (
            ("model", "behind the safeguard") if guarded else ("own version", "without a safeguard")
        )
        cells = "; ".join(
            f"{_where(line, told)} {line['verdict']} ({percent(line['improvement_percent'])})"
            for _, line in mine.iterrows()
        )
        lines.append(f"**The paper's {what} {name}**, {how}: {cells}.")
    return lines


def _safeguard(methods: Mapping[str, MethodSummary], table: pd.DataFrame) -> list[str]:
    guarded = [name for name in having(methods, "learned") if methods[name].guarded]
    mine = table[table["method"].isin(guarded) & table["improvement_percent"].notna()]
    if mine.empty:
        return []
    margin, told = percent(MARGIN_PERCENT), conditions(table)
    worse = mine[mine["improvement_percent"] < MARGIN_PERCENT]
    if worse.empty:
        line = mine.iloc[int(mine["improvement_percent"].to_numpy(dtype=float).argmin())]
        return [
            f"**The safeguard holds**: no safeguarded method is worse than {margin} on the mean "
            f"in any class. The worst is **{line['method']}** in {_where(line, told)} with "
            f"{percent(line['improvement_percent'])}."
        ]
    cases = "; ".join(
        f"**{name}** in "
        + ", ".join(
            f"{_where(line, told)} ({percent(line['improvement_percent'])})"
            for _, line in lines.iterrows()
        )
        for name, lines in worse.groupby("method", sort=False)
    )
    return [
        f"**The safeguard does not hold**: worse than {margin} on the mean, though safeguarded: "
        f"{cases}."
    ]


def _failures(table: pd.DataFrame) -> list[str]:
    failed, told = table[table["failed"] > 0], conditions(table)
    if failed.empty:
        return []
    cases = "; ".join(
        f"**{line['method']}** in {_where(line, told)} {line['failed']} of {line['outages']}"
        for _, line in failed.iterrows()
    )
    return [
        f"Failed outages: {cases}. Averages leave them out, harm counts hold them, and with them "
        "no method is called helpful or harmless."
    ]


def _where(line: "pd.Series", told: Mapping[Cell, str]) -> str:
    cell = cell_of(line)
    return f"{cell.gyro_class} {told[cell]}"
