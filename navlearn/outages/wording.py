"""Says in plain words what a comparison allows to say, and no more."""

import math

from navlearn.outages.run_summary import RunSummary
from navlearn.outages.statistics import FEWEST_UNITS, Comparison, averages
from navlearn.outages.tables import comparisons


def meaning(summary: RunSummary) -> list[str]:
    """Return the paragraphs of "What this means".

    Args:
        summary: The run.
    """
    baselines = [name for name in summary.baselines if name in summary.methods]
    lines = [_best(summary)]
    for baseline in baselines:
        lines += [
            sentence(name, baseline, found)
            for name, found in comparisons(summary, baseline).items()
            if name not in baselines[: baselines.index(baseline)]
        ]
    if not baselines:
        lines.append("No baseline was run, so nothing can be said about improvement.")
    lines.append(_scope(summary))
    return lines


def sentence(method: str, baseline: str, found: Comparison) -> str:
    """Return one comparison in plain words.

    Args:
        method: Name of the method.
        baseline: Name of the baseline.
        found: The comparison.
    """
    if math.isnan(found.improvement_percent):
        return f"**{method}** and **{baseline}** share no outage in which both have a figure."
    size = abs(found.improvement_percent)
    way = "smaller" if found.improvement_percent >= 0.0 else "larger"
    head = (
        f"Against **{baseline}**, the mean error of **{method}** is {size:.0f} % {way} "
        f"(improvement {percent(found.improvement_percent)}, 95 % interval "
        f"{percent(found.low_percent)} to {percent(found.high_percent)})"
    )
    tail = (
        f" It was better in {found.wins} of {found.pairs} outages and more than 10 % worse in "
        f"{found.harm_count}."
    )
    if found.verdict == "helps":
        return f"{head}: it helps in these outages.{tail}"
    if found.verdict == "harms":
        return f"{head}: it harms in these outages.{tail}"
    if found.units < FEWEST_UNITS:
        why = f"{found.units} {found.drawn_by}s are too few for a verdict"
    else:
        why = "the interval includes zero, so the difference may be chance"
    return f"{head}: no evidence that it helps or harms, because {why}.{tail}"


def percent(value: float) -> str:
    """Return a signed figure in percent, with a true minus sign.

    Args:
        value: Percent.
    """
    digits = 0 if abs(value) >= 1.0 else 1
    return f"{value:+.{digits}f} %".replace("-", "−")


def _best(summary: RunSummary) -> str:
    medians = {
        name: averages(summary.rows, name, summary.metric).median for name in summary.methods
    }
    medians = {name: value for name, value in medians.items() if math.isfinite(value)}
    if not medians:
        return "No method finished an outage."
    best, worst = min(medians, key=medians.__getitem__), max(medians, key=medians.__getitem__)
    return (
        f"The smallest median is that of **{best}** ({medians[best]:.2f}), the "
        f"largest that of **{worst}** ({medians[worst]:.2f}), by "
        f"`{summary.metric}`. A smallest median alone is no verdict: the comparisons below are."
    )


def _scope(summary: RunSummary) -> str:
    drives = len(summary.drives)
    outages = sum(len(drive.placement.outages) for drive in summary.drives)
    if drives == 1:
        return (
            f"All of this is about {outages} outages of one drive. It tells nothing about other "
            "cars, sensors or roads: a general claim needs several drives and about a hundred "
            "outages."
        )
    rest = (
        ""
        if outages >= 100 and drives >= FEWEST_UNITS
        else (" A general claim needs about a hundred outages on more drives than that.")
    )
    return f"This rests on {outages} outages of {drives} drives.{rest}"
