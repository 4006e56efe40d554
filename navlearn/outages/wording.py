"""Says in plain words what a comparison allows to say, and no more.

A learned method helps, is harmless or harms; a baseline is only better or worse than another
baseline.
"""

import math

from navlearn.outages.naming import counted
from navlearn.outages.statistics import FEWEST_UNITS, MARGIN_PERCENT, Comparison

MARGIN_WHY = (
    "less than a third of what counts as harm in a single outage, and not to be noticed beside the "
    "error of a fix"
)
"""Why a loss within the margin counts as harmless."""

_SAID = {
    "helps": "it helps in these outages",
    "harms": "it harms in these outages",
    "harmless": "it is harmless in these outages, because the whole interval lies above "
    f"{MARGIN_PERCENT:.0f} %".replace("-", "−")
    + ", though not above zero",
}
_SAID_OF_OTHERS = {
    "helps": "it is better in these outages",
    "harms": "it is worse in these outages",
    "harmless": "it is no worse in these outages, because the whole interval lies above "
    f"{MARGIN_PERCENT:.0f} %".replace("-", "−"),
}


def sentence(method: str, baseline: str, found: Comparison, *, learned: bool = False) -> str:
    """Return one comparison in plain words.

    Args:
        method: Name of the method.
        baseline: Name of the baseline.
        found: The comparison.
        learned: Whether the method is learned; else nothing of it could help or harm.
    """
    if found.pairs == 0:
        return f"**{method}** and **{baseline}** share no outage in which both have a figure."
    if never_differs(found):
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
        f" It was better in {found.wins} of {counted(found.pairs, 'outage')} "
        f"({found.win_rate_percent:.0f} %){equal} and more than 10 % worse in {found.harm_count}."
    )
    said = (_SAID if learned else _SAID_OF_OTHERS).get(found.verdict)
    if said is not None:
        return f"{head}: {said}.{tail}"
    what = "that it helps or harms" if learned else "of a difference"
    return f"{head}: no evidence {what}, because {_why_not(found)}.{tail}"


def never_differs(found: Comparison) -> bool:
    """Return whether a method equals the baseline in every outage.

    Args:
        found: Their comparison.
    """
    return found.pairs > 0 and found.ties == found.pairs and found.failed == 0


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
    if found.low_percent > MARGIN_PERCENT:
        return f"it failed in {found.failed} that the other one finished"
    return "the interval includes zero, so the difference may be chance"


def _never_differs(method: str, baseline: str, found: Comparison, learned: bool) -> str:
    where = f"all {found.pairs} outages" if found.pairs > 1 else "the only outage"
    same = f"**{method}** equals **{baseline}** in {where}"
    if not learned:
        return f"{same}."
    return (
        f"{same}: it never acted (its reasons below tell why). So it did neither good nor harm "
        "here, and whether its corrections would have helped is not known."
    )
