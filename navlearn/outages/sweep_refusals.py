"""What filters refused over the drives of a sweep: its files, and the chapter of its report."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import pandas as pd

from navlearn.outages.detection import GOOD, wilson_interval
from navlearn.outages.markdown import markdown_table, number
from navlearn.outages.output import OutputFolder
from navlearn.outages.refused_drive import DriveRefusals
from navlearn.outages.refused_report import COLUMNS, COUNTS, FAULTS, FIXES, RANGES
from navlearn.outages.run_summary import Chapter

CLASS: Final = "gyro_class"
"""Column of the class of gyros, as in the rows of a sweep."""

FAULTY: Final = "any fault"
"""What the fixes of all kinds of faults are called together."""


def write_sweep_refusals(
    output: OutputFolder, found: Sequence[tuple[str, DriveRefusals]]
) -> Chapter:
    """Write the refused fixes, their counts and the faults of all drives of a sweep.

    Each file is that of a single run, with the class of gyros in front: ``refused_fixes.csv``,
    ``refused_counts.csv``; ``refused_ranges.csv`` of tightly coupled filters, and ``faults.csv``,
    where there is anything to be in them.

    Args:
        output: The sweep's folder.
        found: What was refused, drive by drive, with its class.

    Returns:
        The chapter of the report.

    Raises:
        OutputExistsError: A file of that name exists which no run wrote.
    """
    every = (FIXES, COUNTS, RANGES, FAULTS)
    names = [name for name in every if any(name in one.files for _, one in found)]
    tables = {
        name: together((gyro, one.files[name]) for gyro, one in found if name in one.files)
        for name in names
    }
    for name, table in tables.items():
        table.to_csv(output.claim(name), index=False, lineterminator="\n")
    section = [
        "## Refused fixes\n",
        "Each filter ran once over every whole drive with all its fixes, its clocks set as for the "
        "first of the lengths of outages. The files tell every measurement with its reason: "
        + ", ".join(f"`{name}`" for name in names)
        + ".\n",
        *counts_by_class(tables[COUNTS]),
    ]
    if FAULTS in tables:
        section += caught_by_class(together((gyro, one.caught) for gyro, one in found))
    section += [
        f"- `{method}` was lost over the whole of {one.drive}: {why}"
        for _, one in found
        for method, why in one.lost.items()
    ]
    return Chapter(section=tuple(section))


def together(parts: Iterable[tuple[str, pd.DataFrame]]) -> pd.DataFrame:
    """Return tables of several drives as one, their class in front.

    Args:
        parts: Class and table of each drive; those without rows only tell columns.
    """
    tables = []
    for gyro, part in parts:
        table = part.copy()
        table.insert(0, CLASS, gyro)
        tables.append(table)
    full = [table for table in tables if len(table)]
    return pd.concat(full, ignore_index=True) if full else tables[0]


def counts_by_class(counts: pd.DataFrame) -> list[str]:
    """Return the table of verdicts, summed over the drives of each class.

    Args:
        counts: A row per class, drive, method and kind: ``measured`` and a column per verdict.
    """
    if counts.empty:
        return []
    figures = ["measured", *COLUMNS]
    sums = counts.groupby([CLASS, "method", "kind"], sort=False)[figures].sum()
    cells = [
        [*map(str, key), *(str(row[name]) for name in figures)]
        for key, (_, row) in zip(sums.index, sums.iterrows(), strict=True)
    ]
    header = ["class", "method", "kind", "measured", *COLUMNS.values()]
    return [markdown_table(header, cells, texts=3)]


def caught_by_class(caught: pd.DataFrame) -> list[str]:
    """Return what a report says of faults that were put into fixes.

    Args:
        caught: A row per class, drive, method and kind of fault: ``fixes`` and ``caught``.
    """
    # a filter that takes raw ranges alone has no position fixes to catch
    caught = caught[caught["fixes"] > 0] if len(caught) else caught
    if caught.empty:
        return []
    faulty = caught[caught["kind"] != GOOD].assign(kind=FAULTY)
    kinds = pd.concat([caught[caught["kind"] != GOOD], faulty, caught[caught["kind"] == GOOD]])
    cells = []
    for (gyro, method), mine in kinds.groupby([CLASS, "method"], sort=False):
        for kind, part in mine.groupby("kind", sort=False):
            fixes, hits = int(part["fixes"].sum()), int(part["caught"].sum())
            low, high = wilson_interval(hits, fixes)
            cells.append(
                [
                    str(gyro), str(method), str(kind), str(fixes), str(hits),
                    number(100.0 * (hits / fixes if fixes else np.nan), 1),
                    f"{number(100.0 * low, 1)} to {number(100.0 * high, 1)}",
                ]
            )  # fmt: skip
    header = ["class", "method", "fault", "position fixes", "caught", "%", "95 % interval"]
    return [
        "\n**Faults put in.** Caught is a position fix that was refused or taken with less than "
        "half its weight; what is caught of good fixes are false alarms. Intervals take fixes "
        "for independent, which those of one long fault are not.\n",
        markdown_table(header, cells, texts=3),
    ]
