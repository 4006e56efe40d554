"""The report of a sweep as Markdown: what it means, then the figures behind it."""

import pandas as pd

from navlearn.outages.acting import safeguard_section
from navlearn.outages.cells import cells_of, conditions
from navlearn.outages.markdown import one_line
from navlearn.outages.naming import counted
from navlearn.outages.published import published_section
from navlearn.outages.report_methods import described
from navlearn.outages.satellite_tables import satellite_section
from navlearn.outages.statistics import FEWEST_UNITS, MARGIN_PERCENT
from navlearn.outages.sweep_summary import SweepCell, SweepSummary
from navlearn.outages.sweep_tables import cell_markdown, overview_markdown
from navlearn.outages.sweep_wording import sweep_meaning, sweep_warnings
from navlearn.outages.wording import MARGIN_WHY, percent

COMPETING = ("baseline", "learned")


def sweep_text(
    summary: SweepSummary, table: pd.DataFrame, by_satellites: pd.DataFrame | None = None
) -> str:
    """Return the report of a sweep as Markdown.

    Args:
        summary: The sweep.
        table: Its table.
        by_satellites: Its table by number of satellites, where some stay.
    """
    sections = [
        f"# {summary.title}\n",
        *(f"> {line}\n" for line in (*sweep_warnings(summary), *summary.remarks)),
        f"**Question.** {summary.question}\n",
        "## What this means\n",
        *(f"- {line}" for line in sweep_meaning(summary, table)),
        *(["", *satellite_section(by_satellites)] if by_satellites is not None else []),
        *(published_section(summary.published) if by_satellites is not None else []),
        "\n## Improvement at a glance\n",
        f"Percent of the mean `{summary.metric}` of `{summary.baseline}`, with the 95 % interval; "
        f"of `{summary.baseline}` itself the mean. Methods that learn and baselines:\n",
        overview_markdown(_of(table, *COMPETING)),
        *_apart(table),
        *(f"![{text}]({file})\n\n*{text}*\n" for file, text in summary.figures.items()),
        "\n## Class by class\n",
        _how(table),
        *(_cell(summary, table, cell) for cell in summary.cells),
        *(published_section(summary.published) if by_satellites is None else []),
        *(line for chapter in summary.chapters for line in ("", *chapter.section)),
        "\n## Methods\n",
        *described(summary.methods),
        *safeguard_section(summary.rows, list(summary.methods)),
        *(["\n**What came from what.**\n"] if summary.setup else []),
        *(f"- {line}" for line in summary.setup),
        "\n## Run it again\n",
        f"```\n{summary.command}\n```\n",
        *_time(summary),
        one_line("Versions", summary.versions),
        one_line("Seeds", {**summary.seeds, "bootstrap": summary.bootstrap_seed}),
    ]
    return "\n".join(sections) + "\n"


def _apart(table: pd.DataFrame) -> list[str]:
    """Return the overview of those that do not compete."""
    rest = table[~table["role"].isin(COMPETING)]
    if rest.empty:
        return []
    return [
        "No competitors, since no car could run them while it drives:\n",
        overview_markdown(rest),
    ]


def _how(table: pd.DataFrame) -> str:
    drawn = sorted(set(table["drawn_by"].dropna()))
    return (
        f"Improvement: 100 (1 − mean error / mean error of the baseline). Intervals: paired "
        f"bootstrap drawn by {' or '.join(drawn)}. `helps`: the interval lies above zero; `harms`: "
        f"below; `harmless`: all of it above {percent(MARGIN_PERCENT)}, {MARGIN_WHY}; else, and "
        f"with fewer than {FEWEST_UNITS} {' or '.join(f'{one}s' for one in drawn)}, "
        "`no evidence`. Share of the oracle: of what knowing the deterministic sensor errors "
        "gains, with its 95 % interval; a dash where that gain is not clear of zero.\n"
    )


def _cell(summary: SweepSummary, table: pd.DataFrame, cell: SweepCell) -> str:
    part = dict(cells_of(table))[cell.key]
    shown = [f"### {cell.gyro_class}, {conditions(table)[cell.key]}\n"]
    said = [summary.classes.get(cell.gyro_class, ""), cell.remark]
    words = " ".join(f"{one[0].upper()}{one[1:].rstrip('.')}." for one in said if one)
    count = f"{counted(len(cell.drives), 'drive')}: {', '.join(cell.drives)}."
    scored = set(dict(cells_of(summary.rows))[cell.key]["drive"])
    lost = [name for name in cell.drives if name not in scored]
    count += f" No outage of {', '.join(lost)} was scored." if lost else ""
    shown += [f"{words} {count}".lstrip() + "\n", cell_markdown(_of(part, *COMPETING))]
    for role, heading in (
        ("post-processing", "Post-processing, which knows what came after:"),
        ("oracle", "Oracles, which know what no car can:"),
    ):
        mine = _of(part, role)
        if not mine.empty:
            shown += [f"{heading}\n", cell_markdown(mine)]
    return "\n".join(shown)


def _of(part: pd.DataFrame, *roles: str) -> pd.DataFrame:
    return part[part["role"].isin(roles)]


def _time(summary: SweepSummary) -> list[str]:
    if summary.wall_clock is None:
        return []
    minutes, seconds = divmod(round(summary.wall_clock), 60)
    hours, minutes = divmod(minutes, 60)
    spent = f"{hours} h {minutes} min" if hours else f"{minutes} min {seconds} s"
    several = f"{summary.processes} processes" if summary.processes > 1 else "one process"
    return [f"**Time.** {spent} in {several}.\n"]
