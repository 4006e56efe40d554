"""How often what was learned acted, and why it did not: the safeguard's verdicts, counted."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from navlearn.outages.markdown import markdown_table

_NUMBER = re.compile(r"[+−-]?(?<![\w.])\d+(?:\.\d+)?|[+−-]?(?<![\w.])(?:nan|inf)\b")
_WORDS = {True: "acted", False: "stood back"}


@dataclass(frozen=True, kw_only=True)
class Acting:
    """How often what a method learned acted.

    Attributes:
        acted: Outages in which it did.
        asked: Outages with a verdict.
    """

    acted: int
    asked: int


def verdict_columns(notes: Mapping[str, object]) -> dict[str, object]:
    """Return the columns ``used`` and ``reason`` of an outage.

    Args:
        notes: Notes of a solution; those of methods that learn hold ``used`` and ``reason``.

    Returns:
        ``used``: whether what was learned acted, None where nothing is learned; ``reason``: why,
        empty where nothing is learned.
    """
    if "used" not in notes:
        return {"used": None, "reason": ""}
    return {"used": bool(notes["used"]), "reason": str(notes.get("reason", ""))}


def acting(rows: pd.DataFrame, method: str) -> Acting | None:
    """Return how often what a method learned acted, None where it learns nothing.

    Args:
        rows: Table of outages, as ``outages.csv``, fresh or read back.
        method: Name of the method.
    """
    used = _verdicts(rows[rows["method"] == method])["used"]
    return Acting(acted=int(used.sum()), asked=len(used)) if len(used) else None


def reasons(rows: pd.DataFrame, methods: Sequence[str]) -> pd.DataFrame:
    """Return how often each method gave which reason, reasons that differ in figures as one.

    Args:
        rows: Table of outages, as ``outages.csv``, fresh or read back.
        methods: Names, in the order of the table.

    Returns:
        ``method``, ``used``, ``outages``, ``reason``: the most frequent first within a method;
        figures that differ are given as a range.
    """
    table = []
    for name in methods:
        mine = _verdicts(rows[rows["method"] == name])
        for used, part in mine.groupby("used", sort=False):
            for _, alike in part.groupby(part["reason"].map(_shape), sort=False):
                line = (name, bool(used), len(alike), _joined(alike["reason"].tolist()))
                table.append(line)
    found = pd.DataFrame(table, columns=["method", "used", "outages", "reason"])
    order = found["method"].map({name: k for k, name in enumerate(methods)})
    return (
        found.assign(order=order)
        .sort_values(["order", "outages"], ascending=[True, False], kind="stable")
        .drop(columns="order")
        .reset_index(drop=True)
    )


def safeguard_section(rows: pd.DataFrame, methods: Sequence[str]) -> list[str]:
    """Return the counts of the safeguard's reasons as Markdown, nothing where nobody learns.

    Args:
        rows: Table of outages, as ``outages.csv``.
        methods: Names, in the order of the table.
    """
    found = reasons(rows, methods)
    if found.empty:
        return []
    lines = [
        (str(name), _WORDS[bool(used)], str(reason).replace("|", "\\|") or "–", str(outages))
        for name, used, outages, reason in found.itertuples(index=False)
    ]
    return [
        "\n### What the safeguard said\n",
        "Each outage's own verdict is in the columns `used` and `reason` of `outages.csv`.\n",
        markdown_table(("method", "verdict", "reason", "outages"), lines, texts=3),
    ]


def _verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """Return ``used`` as booleans and ``reason`` of the rows that have a verdict."""
    if "used" not in rows.columns:
        return pd.DataFrame({"used": pd.Series(dtype=bool), "reason": pd.Series(dtype=str)})
    # Read back from CSV, truth values beside empty cells are words.
    used = rows["used"].map({True: True, False: False, "True": True, "False": False})
    known = used.notna()
    return pd.DataFrame(
        {
            "used": used[known].astype(bool),
            "reason": rows.loc[known, "reason"].fillna("").astype(str),
        }
    )


def _shape(reason: str) -> str:
    return _NUMBER.sub("#", reason)


def _joined(alike: Sequence[str]) -> str:
    """Return reasons of one shape as one, with the range of each figure that differs."""
    found = [_NUMBER.findall(reason) for reason in alike]
    ranges = iter(_range([numbers[k] for numbers in found]) for k in range(len(found[0])))
    return _NUMBER.sub(lambda _: next(ranges), alike[0])


def _range(numbers: Sequence[str]) -> str:
    known = sorted(
        (value, text) for text in numbers if math.isfinite(value := float(text.replace("−", "-")))
    )
    if not known or known[0][1] == known[-1][1]:
        return known[0][1] if known else numbers[0]
    return f"{known[0][1]} to {known[-1][1]}"
