"""Writes ``report.md``: what was asked, how it was judged, what came out, what it means."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from navlearn.outages.cells import are_partial
from navlearn.outages.markdown import markdown_table, number, one_line
from navlearn.outages.meaning import meaning, run_warnings
from navlearn.outages.naming import counted
from navlearn.outages.published import published_section
from navlearn.outages.report_methods import in_order, methods_section
from navlearn.outages.roles import real_time
from navlearn.outages.run_summary import Chapter, DriveSummary, RunSummary
from navlearn.outages.schedule import OutageProtocol

MOST_OUTAGES = 60


def write_report(path: Path, summary: RunSummary) -> Path:
    """Write the report of a run.

    Args:
        path: The file to write; figures are embedded by their path relative to it.
        summary: The run.

    Returns:
        The path.
    """
    path.write_text(report_text(summary), encoding="utf-8")
    return path


def report_text(summary: RunSummary) -> str:
    """Return the report of a run as Markdown.

    Args:
        summary: The run.
    """
    sections = [
        f"# {summary.title}\n",
        *(f"> {remark}\n" for remark in (*run_warnings(summary), *summary.remarks)),
        f"**Question.** {summary.question}\n",
        "## What this means\n",
        *(f"- {line}" for line in meaning(summary)),
        "\n## Methods side by side\n",
        *methods_section(summary),
        *published_section(summary.published),
        "\n## Drives and protocol\n",
        *(_drive_text(drive) for drive in summary.drives),
        _protocol_text(summary.protocol),
        *_setup(summary),
        *_exclusions(summary.drives),
        *_figures(summary),
        *(line for chapter in summary.chapters for line in _chapter(chapter)),
        "\n## Every outage\n",
        *_outage_section(summary),
        "\n## Run it again\n",
        f"```\n{summary.command}\n```\n",
        one_line("Versions", summary.versions),
        one_line("Seeds", {**summary.seeds, "bootstrap": summary.bootstrap_seed}),
    ]
    return "\n".join(sections) + "\n"


def _drive_text(drive: DriveSummary) -> str:
    source = f", from {drive.source}" if drive.source else ""
    licence = f" Licence of the data: {drive.license}." if drive.license else ""
    words = pd.Series(drive.placement.dynamics).value_counts()
    what = ", ".join(f"{count} {word}" for word, count in words.items())
    notes = "".join(f"\n  - {note}" for note in drive.placement.notes)
    return (
        f"- **{drive.name}**{source}: {drive.duration / 60.0:.1f} min, "
        f"{drive.distance / 1000.0:.1f} km, {len(drive.placement.outages)} outages ({what}), "
        f"judged by its {drive.judged_by}.{licence}{notes}"
    )


def _protocol_text(protocol: OutageProtocol) -> str:
    if protocol.placement == "listed":
        where = f"{len(protocol.times)} outages of {protocol.duration:g} s at listed times"
        rules = ""
    else:
        seed = f" with seed {protocol.seed}" if protocol.placement == "random" else ""
        where = (
            f"{protocol.count} outages of {protocol.duration:g} s per drive, placement "
            f"`{protocol.placement}`{seed}"
        )
        rules = (
            f", none before a warm-up of {protocol.warm_up:g} s of which "
            f"{protocol.warm_up_moving:g} s moving, at least {protocol.min_gap:g} s apart, only "
            f"where fixes are at most {protocol.max_fix_interval:g} s apart (from "
            f"{protocol.good_before:g} s before) and the mean speed is at least "
            f"{protocol.min_mean_speed:g} m/s (half of that in stops)"
        )
    return (
        f"\n**Protocol.** {where}{rules}. From its start on, within an outage and after it, no fix "
        f"exists for any method{_staying(protocol)}. Not scored is where the reference has a hole "
        f"longer than {protocol.max_reference_interval:g} s, or slides more than "
        f"{protocol.max_reference_slip:g} m against its own velocity within "
        f"{protocol.slip_span:g} s.\n"
    )


def _staying(protocol: OutageProtocol) -> str:
    if protocol.satellites == 0:
        return ", nor any raw range"
    stay = counted(protocol.satellites, "satellite")
    return f", nor any raw range, but within the outage those of {stay} (`{protocol.visible}`)"


def _setup(summary: RunSummary) -> list[str]:
    if not summary.setup:
        return []
    return ["**What came from what.**\n", *(f"- {line}" for line in summary.setup), ""]


def _exclusions(drives: Sequence[DriveSummary]) -> list[str]:
    lines = [
        (drive.name, f"{one.start:.1f}", f"{one.end:.1f}", one.reason)
        for drive in drives
        for one in drive.placement.excluded
    ]
    if not lines:
        return ["**Excluded.** Nothing: these rules found nothing bad in any drive.\n"]
    return ["**Excluded.**\n", markdown_table(("drive", "from s", "to s", "reason"), lines)]


def _figures(summary: RunSummary) -> list[str]:
    if not summary.figures:
        return [
            "\n## Figures\n\nNone were drawn; `pip install 'navlearn[report]'` and run again.\n"
        ]
    return ["\n## Figures\n", *_pictures(summary.figures)]


def _chapter(chapter: Chapter) -> list[str]:
    return ["", *chapter.section, *_pictures(chapter.figures)]


def _pictures(figures: Mapping[str, str]) -> list[str]:
    return [f"![{text}]({file})\n\n*{text}*\n" for file, text in figures.items()]


def _outage_section(summary: RunSummary) -> list[str]:
    rows = summary.rows
    table = rows.pivot_table(
        index=["drive", "outage"], columns="method", values=summary.metric, dropna=False
    )
    first = rows.drop_duplicates(["drive", "outage"]).set_index(["drive", "outage"])
    several, partial = len(summary.drives) > 1, are_partial(rows)
    methods, competing = in_order(summary), real_time(summary.methods)
    header = ["outage", "start s", "dynamics", *(["satellites"] if partial else [])]
    header += ["distance m", *methods]
    lines = []
    for key in list(first.index)[:MOST_OUTAGES]:
        about = first.loc[key]
        values = {name: float(table.loc[key].get(name, math.nan)) for name in methods}
        name = f"{key[0]} {key[1]}" if several else str(key[1])
        lines.append(
            [
                name, f"{about['start_s']:.1f}", str(about["dynamics"]),
                *([str(about["satellites_visible"]) or "none"] if partial else []),
                number(about["distance_m"], 0), *_best_in_bold(values, competing),
            ]
        )  # fmt: skip
    whose = (
        "" if len(competing) == len(methods) else " of the methods that run while the car drives"
    )
    out = [f"`{summary.metric}`, the smallest{whose} in bold.\n", markdown_table(header, lines)]
    if len(first) > MOST_OUTAGES:
        out.append(f"The first {MOST_OUTAGES} of {len(first)}; all are in `outages.csv`.\n")
    failed = rows.loc[rows["failure"] != "", ["drive", "method", "outage", "failure"]]
    out += [f"- {d}, {m}, outage {k}: {why}" for d, m, k, why in failed.to_numpy()]
    return out


def _best_in_bold(values: Mapping[str, float], competing: Sequence[str]) -> list[str]:
    best = min((values[name] for name in competing if math.isfinite(values[name])), default=None)
    return [
        f"**{number(value)}**" if name in competing and value == best else number(value)
        for name, value in values.items()
    ]
