"""Says in plain words what a comparison allows to say, and no more.

A learned method helps or harms; a baseline is only better or worse than another baseline.
"""

import math

from navlearn.outages.naming import counted, with_unit
from navlearn.outages.run_summary import RunSummary, comparisons
from navlearn.outages.statistics import FEWEST_UNITS, Comparison, averages

BASELINE_VERDICTS = {"helps": "better", "harms": "worse"}
"""What is said of a baseline instead."""


def meaning(summary: RunSummary) -> list[str]:
    """Return the paragraphs of "What this means": learned methods first.

    Args:
        summary: The run.
    """
    baselines = [name for name in summary.baselines if name in summary.methods]
    learned = [name for name, about in summary.methods.items() if about.regime != "none"]
    found = {baseline: comparisons(summary, baseline) for baseline in baselines}
    lines = [
        sentence(name, baseline, found[baseline][name], learned=True)
        + _whose_gain(name, baseline, baselines[0], found)
        for name in learned
        for baseline in baselines
        if name != baseline
    ]
    lines.append(_best(summary))
    lines += [
        sentence(name, baseline, one)
        for k, baseline in enumerate(baselines)
        for name, one in found[baseline].items()
        if name not in learned and name not in baselines[:k]
    ]
    if not baselines:
        lines.append("No baseline was run, so nothing can be said about improvement.")
    return [*lines, *_failures(summary), *_judge(summary), _scope(summary)]


def sentence(method: str, baseline: str, found: Comparison, *, learned: bool = False) -> str:
    """Return one comparison in plain words.

    Args:
        method: Name of the method.
        baseline: Name of the baseline.
        found: The comparison.
        learned: Whether the method is learned; else it is a baseline too.
    """
    if found.pairs == 0:
        return f"**{method}** and **{baseline}** share no outage in which both have a figure."
    if found.ties == found.pairs and found.failed == 0:
        return _never_differs(method, baseline, found, learned)
    if math.isnan(found.improvement_percent):
        return f"**{baseline}** has no error at all, so **{method}** cannot be compared with it."
    equal = f", equal in {found.ties}" if found.ties else ""
    interval = (
        f"95 % interval {percent(found.low_percent)} to {percent(found.high_percent)}"
        if math.isfinite(found.low_percent)
        else "no interval"
    )
    head = (
        f"Against **{baseline}**, the mean error of **{method}** is "
        f"{_how_much(found.improvement_percent)} (improvement "
        f"{percent(found.improvement_percent)}, {interval})"
    )
    tail = (
        f" It was better in {found.wins} of {counted(found.pairs, 'outage')}{equal} and more "
        f"than 10 % worse in {found.harm_count}."
    )
    if found.verdict in BASELINE_VERDICTS:
        said = found.verdict if learned else f"is {BASELINE_VERDICTS[found.verdict]}"
        return f"{head}: it {said} in these outages.{tail}"
    what = "that it helps or harms" if learned else "of a difference"
    return f"{head}: no evidence {what}, because {_why_not(found)}.{tail}"


def percent(value: float) -> str:
    """Return a signed figure in percent, with a true minus sign.

    Args:
        value: Percent.
    """
    digits = 0 if abs(value) >= 1.0 else 1
    text = f"{value:+.{digits}f} %"
    return "0 %" if float(text[:-2]) == 0.0 else text.replace("-", "−")


def _how_much(improvement: float) -> str:
    if improvement < -100.0:
        return f"{1.0 - 0.01 * improvement:.1f} times as large"
    size = percent(abs(improvement)).removeprefix("+")
    return f"{size} {'smaller' if improvement >= 0.0 else 'larger'}"


def _why_not(found: Comparison) -> str:
    if found.units < FEWEST_UNITS:
        one = found.units == 1
        drawn = f"one {found.drawn_by} is" if one else f"{found.units} {found.drawn_by}s are"
        return f"{drawn} too few for a verdict"
    if found.low_percent > 0.0:
        return f"it failed in {found.failed} that the other one finished"
    return "the interval includes zero, so the difference may be chance"


def _never_differs(method: str, baseline: str, found: Comparison, learned: bool) -> str:
    where = f"all {found.pairs} outages" if found.pairs > 1 else "the only outage"
    same = f"**{method}** equals **{baseline}** in {where}"
    if not learned:
        return f"{same}."
    return (
        f"{same}: it never acted (its notes below tell why). So it did neither good nor harm "
        "here, and whether its corrections would have helped is not known."
    )


def _whose_gain(
    name: str, baseline: str, first: str, found: dict[str, dict[str, Comparison]]
) -> str:
    """Return a warning where a gain over a weak baseline is that of the filter underneath."""
    if baseline == first or found[baseline][name].verdict != "helps":
        return ""
    if found[first][name].verdict == "helps" or found[baseline][first].verdict != "helps":
        return ""
    gain = percent(found[baseline][first].improvement_percent)
    return f" But **{first}** alone gains {gain} there: this is no merit of what was learned."


def _best(summary: RunSummary) -> str:
    medians = {
        name: averages(summary.rows, name, summary.metric).median for name in summary.methods
    }
    medians = {name: value for name, value in medians.items() if math.isfinite(value)}
    if not medians:
        return "No method finished an outage."
    low, high = min(medians.values()), max(medians.values())
    best, worst = (
        " and ".join(f"**{name}**" for name, value in medians.items() if value == edge)
        for edge in (low, high)
    )
    return (
        f"The smallest median is that of {best} ({with_unit(low, summary.metric)}), the "
        f"largest that of {worst} ({with_unit(high, summary.metric)}), by "
        f"`{summary.metric}`. A smallest median alone is no verdict: the comparisons are."
    )


def _failures(summary: RunSummary) -> list[str]:
    lines = []
    for name in summary.methods:
        found = averages(summary.rows, name, summary.metric)
        if found.failed:
            lines.append(
                f"**{name}** failed in {found.failed} of {counted(found.outages, 'outage')} "
                "(reasons below). Its averages leave them out and so flatter it; comparisons count "
                "them as worse."
            )
    return lines


def _judge(summary: RunSummary) -> list[str]:
    names = [drive.name for drive in summary.drives if drive.judged_by == "fixes"]
    if not names:
        return []
    return [
        f"{', '.join(names)}: judged by its own GNSS fixes, which were withheld from every method "
        "through each outage. Their own error is part of every figure, so differences of a metre "
        "or two say little."
    ]


def _scope(summary: RunSummary) -> str:
    drives = len(summary.drives)
    outages = sum(len(drive.placement.outages) for drive in summary.drives)
    if drives == 1:
        return (
            f"All of this is about {counted(outages, 'outage')} of one drive. It tells nothing "
            "about other cars, sensors or roads: a general claim needs several drives and about a "
            "hundred outages."
        )
    rest = (
        ""
        if outages >= 100 and drives >= FEWEST_UNITS
        else (" A general claim needs about a hundred outages on more drives than that.")
    )
    return f"This rests on {outages} outages of {drives} drives.{rest}"
