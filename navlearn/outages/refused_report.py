"""The part of a report that says what each filter refused, and why; and its files."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.outages.canvas import plots_possible
from navlearn.outages.detection import detection_by_kind
from navlearn.outages.markdown import markdown_table, number
from navlearn.outages.output import OutputFolder
from navlearn.outages.refused_fixes import Judgements, refused_table, verdict_counts
from navlearn.outages.refused_plots import plot_refused_map, plot_refused_over_time
from navlearn.outages.refused_ranges import RangeJudgements, range_counts, refused_ranges_table
from navlearn.outages.run_summary import Chapter

FIXES: Final = "refused_fixes.csv"
COUNTS: Final = "refused_counts.csv"
RANGES: Final = "refused_ranges.csv"
FAULTS: Final = "faults.csv"

MOST_SHOWN: Final = 10
"""So many refused fixes of each method are shown in the report; the file has all."""

COLUMNS: Final = {
    "refused_by_gate": "by χ² gate",
    "refused_by_prediction": "by prediction",
    "refused_by_motion": "by motion",
    "accepted_by_reset": "taken by reset",
    "accepted_with_less_weight": "less than half weight",
}
"""Verdicts of the report's table of counts, with their headings."""

_WORDS: Final = {
    "refused_by_gate": "χ² gate",
    "refused_by_prediction": "prediction",
    "refused_by_motion": "motion",
}


@dataclass(frozen=True, kw_only=True)
class Refusals:
    """What one filter made of its measurements over a drive.

    Attributes:
        fixes: What it made of fixes, and of what the car says of itself.
        ranges: What it made of raw ranges; None for a filter that takes none.
    """

    fixes: Judgements
    ranges: RangeJudgements | None = None


def write_refusals(
    output: OutputFolder, found: Mapping[str, Refusals | str], log: DriveLog
) -> Chapter:
    """Write ``refused_fixes.csv``, ``refused_counts.csv``, and, with matplotlib, two figures.

    A tightly coupled filter's refused ranges stand in ``refused_ranges.csv``, faults that were put
    into the fixes in ``faults.csv``.

    Args:
        output: The run's folder.
        found: By method; a sentence where a filter was lost.
        log: The whole drive.

    Returns:
        The chapter of the report.

    Raises:
        OutputExistsError: A file of that name exists which no run wrote.
    """
    whole = {name: one for name, one in found.items() if isinstance(one, Refusals)}
    tables, counts, files = refused_tables(whole, log)
    for name, file in files.items():
        file.to_csv(output.claim(name), index=False)
    drive, faults = log.metadata.name, files.get(FAULTS)
    figures: dict[str, str] = {}
    if tables and plots_possible():
        plot_refused_over_time(output.claim("refused_over_time.png"), tables, faults)
        plot_refused_map(output.claim("refused_map.png"), tables, log)
        figures = {
            "refused_over_time.png": f"How far the positions that filters refused on {drive} were "
            "from their predictions." + (" Grey: faults put in." if faults is not None else ""),
            "refused_map.png": f"Where the refused positions of {drive} were, each joined to where "
            "the car was.",
        }
    lost = {name: one for name, one in found.items() if isinstance(one, str)}
    section = refused_section(tables, counts, lost, ranges=RANGES in files)
    if faults is not None:
        section += detection_section({n: one.fixes for n, one in whole.items()}, log)
    return Chapter(section=tuple(section), figures=figures)


def refused_section(
    tables: Mapping[str, pd.DataFrame],
    counts: Mapping[str, pd.DataFrame],
    lost: Mapping[str, str],
    *,
    ranges: bool = False,
) -> list[str]:
    """Return what a report says of refused measurements.

    Args:
        tables: Refused measurements by method.
        counts: Verdicts by kind and method.
        lost: Why a method has neither.
        ranges: Whether refused ranges were written.
    """
    lines = [
        "## Refused fixes\n",
        "Each filter ran once over the whole drive with all its fixes; up to an outage's start "
        "this is what was believed and refused there, too. Methods that learn stand on `ekf`, or "
        "the filter they name. Every refused measurement is in `refused_fixes.csv` with its "
        "reason, all counts are in `refused_counts.csv`"
        + (", refused ranges in `refused_ranges.csv`.\n" if ranges else ".\n"),
    ]
    if counts:
        cells = [
            [name, str(row["kind"]), *(str(row[key]) for key in ("measured", *COLUMNS))]
            for name, table in counts.items()
            for _, row in table.iterrows()
        ]
        header = ["method", "kind", "measured", *COLUMNS.values()]
        lines.append(markdown_table(header, cells, texts=2))
    lines += [f"- `{name}` was lost over the whole drive: {why}" for name, why in lost.items()]
    return [*lines, *_farthest(tables)]


def _farthest(tables: Mapping[str, pd.DataFrame]) -> list[str]:
    """Return the refused positions that were farthest from their prediction."""
    rows = []
    for name, table in tables.items():
        refused = (table["kind"] == "position") & table["verdict"].isin(_WORDS)
        for _, one in table[refused].nlargest(MOST_SHOWN, "innovation").iterrows():
            limit = one["limit_m"] if np.isfinite(one["limit_m"]) else one["nis_limit"]
            rows.append(
                [
                    name, _WORDS[str(one["verdict"])], number(one["t"], 1),
                    number(one["innovation"], 1), number(one["stated_deviation"], 1),
                    number(one["nis"], 1), number(limit, 1), number(one["fix_error_m"], 1),
                ]
            )  # fmt: skip
    if not rows:
        return ["No position was refused.\n"]
    header = ["method", "reason", "t s", "innovation m", "stated σ m", "NIS", "limit", "error m"]
    told = (
        f"\nThe refused positions farthest from their prediction, at most {MOST_SHOWN} a method; "
        "`limit` is that of the reason (NIS, or m), `error` how far the fix is off the "
        "reference, which no filter knows.\n"
    )
    return [told, markdown_table(header, rows, texts=2)]


def detection_section(judged: Mapping[str, Judgements], log: DriveLog) -> list[str]:
    """Return what a report says of faults that were put into the fixes.

    Args:
        judged: What each method made of its measurements.
        log: The drive, with its faults.
    """
    faults = injected_faults(log)
    if faults is None:
        return []
    rows = []
    for name, one in judged.items():
        for _, row in detection_by_kind(one, faults).iterrows():
            rows.append(
                [
                    name, str(row["kind"]), str(row["fixes"]), str(row["caught"]),
                    number(100.0 * row["share"], 1),
                    f"{number(100.0 * row['low'], 1)} to {number(100.0 * row['high'], 1)}",
                ]
            )  # fmt: skip
    return [
        f"\n**Faults put in.** {len(faults)} faults stand in `faults.csv`. Caught is a position "
        "fix that was refused or taken with less than half its weight; what is caught of good "
        "fixes are false alarms.\n",
        markdown_table(
            ["method", "fault", "position fixes", "caught", "%", "95 % interval"], rows, texts=2
        ),
    ]


class RefusedTables(NamedTuple):
    """What filters refused over a drive, as tables.

    Attributes:
        fixes: Refused measurements by method.
        counts: Verdicts by kind and method.
        files: By name of the file, each with the drive and the method in front; the faults that
            were put in, too.
    """

    fixes: dict[str, pd.DataFrame]
    counts: dict[str, pd.DataFrame]
    files: dict[str, pd.DataFrame]


def refused_tables(whole: Mapping[str, Refusals], log: DriveLog) -> RefusedTables:
    """Return what filters refused over a drive, as tables.

    Args:
        whole: What each method made of its measurements.
        log: The whole drive.
    """
    fixes = {name: refused_table(one.fixes, log) for name, one in whole.items()}
    counts = {name: _counts(one) for name, one in whole.items()}
    taken = {name: one.ranges for name, one in whole.items() if one.ranges is not None}
    drive, faults = log.metadata.name, injected_faults(log)
    files = {FIXES: by_method(fixes, drive), COUNTS: by_method(counts, drive)}
    if taken:
        ranges = {name: refused_ranges_table(one) for name, one in taken.items()}
        files[RANGES] = by_method(ranges, drive)
    if faults is not None:
        files[FAULTS] = faults
    return RefusedTables(fixes, counts, files)


def _counts(one: Refusals) -> pd.DataFrame:
    fixes = verdict_counts(one.fixes)
    return fixes if one.ranges is None else pd.concat([fixes, range_counts(one.ranges)])


def by_method(tables: Mapping[str, pd.DataFrame], drive: str) -> pd.DataFrame:
    """Return tables of several methods as one.

    Args:
        tables: By method.
        drive: Name of the drive, put in front.
    """
    parts = []
    for name, table in tables.items():
        part = table.copy()
        part.insert(0, "drive", drive)
        part.insert(1, "method", name)
        parts.append(part)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"drive": []})
