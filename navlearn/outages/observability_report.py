"""The part of a report that says what a filter could and could not observe, and its files."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from navlearn.outages.canvas import plots_possible
from navlearn.outages.markdown import markdown_table, number
from navlearn.outages.observability_plots import plot_directions, plot_eigenvalues, plot_states
from navlearn.outages.observability_record import (
    ObservabilityRecord,
    spoken,
    write_observability_csv,
)
from navlearn.outages.observability_tables import direction_table, phases, state_table
from navlearn.outages.output import OutputFolder
from navlearn.outages.run_summary import Chapter
from navlearn.outages.schedule import Outage

HARDLY = 0.9
"""A state is called hardly observed if so much of its initial deviation, or more, is left."""

SHADING = (
    "Outages are shaded, standstills marked at the bottom; at 1 a state is as unknown as at the "
    "start, and on the right as the average state."
)


def write_observability(
    output: OutputFolder,
    record: ObservabilityRecord,
    outages: Sequence[Outage],
    *,
    ending: str = "",
    whose: str = "the filter",
) -> Chapter:
    """Write ``observability.csv`` and, with matplotlib, three figures.

    Args:
        output: The run's folder.
        record: The record of a run in which the outages' fixes were taken away.
        outages: The outages.
        ending: What the files' names end with where a run has several drives, such as ``_2``.
        whose: Method and drive that the record is of, for the text.

    Returns:
        The chapter of the report.

    Raises:
        OutputExistsError: A file of that name exists which no run wrote.
    """
    write_observability_csv(output.claim(f"observability{ending}.csv"), record)
    figures: dict[str, str] = {}
    if plots_possible():
        drawn = {
            f"observability_states{ending}.png": (
                plot_states,
                f"Degree of observability of every state of {whose}. {SHADING}",
            ),
            f"observability_eigenvalues{ending}.png": (
                plot_eigenvalues,
                f"Eigenvalues of the normalised covariances of {whose}. {SHADING}",
            ),
            f"observability_directions{ending}.png": (
                plot_directions,
                f"What the best and the least observed direction of {whose} consist of; outages "
                "lie between dashed lines.",
            ),
        }
        for name, (draw, caption) in drawn.items():
            draw(output.claim(name), record, outages)
            figures[name] = caption
    return Chapter(
        section=tuple(observability_section(record, outages, whose=whose)), figures=figures
    )


def observability_section(
    record: ObservabilityRecord, outages: Sequence[Outage], *, whose: str = "the filter"
) -> list[str]:
    """Return the part of a report on observability, as Markdown.

    Args:
        record: The record.
        outages: The outages.
        whose: Method and drive that the record is of.
    """
    out = [
        "\n## Degree of observability\n",
        f"Of {whose}, from its own covariance P: in deviations at the start (P′), and scaled to "
        "the mean of the diagonal (P″). An eigenvalue of P′ below 1 belongs to a direction that "
        "is better known than at the start, above 1 to one that has drifted off. P″ only tells "
        "who holds the largest part of what is unknown at a time: it falls for a state that "
        "grows, where others grow faster, and is never to be read alone.\n",
        "### Best and least observed direction\n",
        _direction_text(direction_table(record, phases(record, outages))),
        "`left` is the deviation in that direction against the start, the root of the eigenvalue "
        "of P′; then the eigenvalue of P″, and the largest components of the eigenvector in "
        "initial deviations.\n",
        "### Every state\n",
        _state_text(state_table(record, outages), with_outages=bool(outages)),
        "Standard deviation at the start, and what is left of it: at the least, "
        + ("where the outages begin and where they end (medians), " if outages else "")
        + "at the drive's end.\n",
        "### What may be concluded\n",
        *(f"- {line}" for line in conclusions(record, outages)),
    ]
    if record.known:
        names = ", ".join(spoken(name) for name in record.known)
        out.append(f"- Left out, as they were known exactly at the start: {names}.")
    return out


def conclusions(record: ObservabilityRecord, outages: Sequence[Outage]) -> list[str]:
    """Return what a reader may conclude, a sentence or two each.

    Args:
        record: The record.
        outages: The outages.
    """
    table = state_table(record, outages)
    out = []
    hardly = list(table.loc[table["least"] >= HARDLY, "state"])
    if hardly:
        out.append(
            f"**Hardly observed on this drive**: {', '.join(hardly)}. The filter keeps what it was "
            f"told at the start ({100.0 * HARDLY:.0f} % of the initial deviation or more is left "
            "at best); their estimates are no measurements."
        )
    else:
        out.append("**Every state** was told something at some time of this drive.")
    if outages:
        fastest = table.sort_values("growth", ascending=False).head(3)
        told = (f"{one['state']} {number(one['growth'], 1)}" for _, one in fastest.iterrows())
        out.append(
            "**Through an outage** these deviations grow most (times, median over outages): "
            f"{', '.join(told)}."
        )
        out += _azimuth(table)
    out.append(
        "**Azimuth** is told by forces, not by rest: at standstill and at constant velocity a "
        "car's position and velocity do not depend on it, unless its direction of travel is "
        "measured against its own axis (odometer, non-holonomic constraint). What counts is how "
        "often the drive accelerates, brakes or turns before an outage."
    )
    if any(name.startswith("accel_bias") for name in record.names):
        out.append(
            "**Horizontal accelerometer biases** hide behind roll and pitch until the car goes "
            "into or out of a curve: where such a bias and a tilt stand together in the least "
            "observed direction, only their combination is known, which serves as long as the car "
            "keeps its heading."
        )
    return out


def _azimuth(table: pd.DataFrame) -> list[str]:
    found = table[table["state"].isin(["azimuth", "phi up"])]
    if found.empty:
        return []
    name, grown, part = (found[key].iloc[0] for key in ("state", "growth", "share_growth"))
    told = "Azimuth" if name == "azimuth" else "Azimuth (phi up)"
    line = (
        f"**{told}** through an outage (median): its deviation becomes "
        f"{number(grown)} times as large, its part in P″ {number(part)} times"
    )
    if grown > 1.0 > part:
        return [f"{line}. It is not better observed: others are lost faster."]
    return [f"{line}."]


def _direction_text(table: pd.DataFrame) -> str:
    kinds = ("best", "least")
    header = ["phase", "moment", *(f"{kind} observed direction" for kind in kinds), "s"]
    header += [f"{kind}: {figure}" for kind in kinds for figure in ("left", "P″")]
    lines = [
        [
            str(row["phase"]),
            str(row["moment"]),
            *(str(row[f"{kind}_direction"]) or "–" for kind in kinds),
            number(row["t"], 1),
            *(
                _digits(float(row[f"{kind}_{figure}"]))
                for kind in kinds
                for figure in ("left", "share")
            ),
        ]
        for _, row in table.iterrows()
    ]
    return markdown_table(header, lines, texts=4)


def _state_text(table: pd.DataFrame, *, with_outages: bool) -> str:
    of_outages = ["outages_start", "outages_end"] if with_outages else []
    figures = ["least", *of_outages, "last"]
    lines = [
        [
            str(row["state"]),
            f"{_digits(float(row['initial']))} {row['unit']}".removesuffix(" 1").strip(),
            *(_digits(float(row[name])) for name in figures),
        ]
        for _, row in table.iterrows()
    ]
    words = {"outages_start": "outages begin", "outages_end": "outages end", "last": "drive ends"}
    heads = [words.get(name, name) for name in figures]
    return markdown_table(["state", "initially", *heads], lines)


def _digits(value: float) -> str:
    """Return a figure with three digits that count, however small."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.3g}".replace("-", "−")
