"""The section "What this means": a paragraph per learned method, then all the others."""

import math

from navlearn.outages.acting import acting
from navlearn.outages.leaks import leak_warnings
from navlearn.outages.naming import counted, with_unit
from navlearn.outages.oracle_share import OracleShare, share_of_columns
from navlearn.outages.roles import ORACLE, having, real_time, roles, verdict_words
from navlearn.outages.run_summary import RunSummary, comparisons
from navlearn.outages.statistics import FEWEST_UNITS, Comparison, averages, error_table
from navlearn.outages.wording import never_differs, percent, sentence

Found = dict[str, dict[str, Comparison]]


def meaning(summary: RunSummary) -> list[str]:
    """Return the paragraphs of "What this means": warnings, then learned methods first.

    Args:
        summary: The run.
    """
    baselines = [name for name in summary.baselines if name in summary.methods]
    found = {baseline: comparisons(summary, baseline) for baseline in baselines}
    shares = oracle_shares(summary)
    lines = []
    for name in having(summary.methods, "learned"):
        if baselines:
            said = _paragraph(summary, name, baselines[0], found[baselines[0]][name])
            lines.append(said + _reached(shares.get(name), baselines[0]))
        for baseline in baselines[1:]:
            said = sentence(name, baseline, found[baseline][name], learned=True)
            lines.append(said + _whose_gain(name, baseline, baselines[0], found))
    lines.append(_best(summary))
    for k, baseline in enumerate(baselines):
        for name in having(summary.methods, "baseline"):
            if name not in baselines[: k + 1]:
                lines.append(sentence(name, baseline, found[baseline][name]))
    if not baselines:
        lines.append("No baseline was run, so nothing can be said about improvement.")
    else:
        lines += _bounds(summary, baselines[0], found[baselines[0]])
    lines = [*run_warnings(summary), *lines]
    return [*lines, *_failures(summary), *_judge(summary), _scope(summary)]


def run_warnings(summary: RunSummary) -> list[str]:
    """Return a warning for every gain of a run that cannot be true.

    Args:
        summary: The run.
    """
    return leak_warnings(
        summary.rows,
        real_time(summary.methods),
        metric=summary.metric,
        resamples=summary.resamples,
        seed=summary.bootstrap_seed,
    )


def oracle_shares(summary: RunSummary) -> dict[str, OracleShare]:
    """Return by method the share of the oracle's gain; empty for a run without an oracle.

    Args:
        summary: The run.
    """
    baselines = [name for name in summary.baselines if name in summary.methods]
    if ORACLE not in summary.methods or not baselines:
        return {}
    errors = error_table(summary.rows, summary.metric)
    return {
        name: share_of_columns(
            errors, name, baselines[0], resamples=summary.resamples, seed=summary.bootstrap_seed
        )
        for name in summary.methods
        if name not in (ORACLE, baselines[0])
    }


def _paragraph(summary: RunSummary, name: str, baseline: str, one: Comparison) -> str:
    verdict = verdict_words(one.verdict, "learned", never_differs=never_differs(one))
    said = f"**{name}: {verdict}.** {sentence(name, baseline, one, learned=True)}"
    if one.pairs == 0 or never_differs(one):
        return said
    mine, other = (averages(summary.rows, which, summary.metric) for which in (name, baseline))
    said += (
        f" The 90th percentile is {with_unit(mine.p90, summary.metric)} ({baseline}: "
        f"{with_unit(other.p90, summary.metric)})."
    )
    return said + _acted(summary, name)


def _acted(summary: RunSummary, name: str) -> str:
    found = acting(summary.rows, name)
    if found is None:
        return ""
    who = "The safeguard let it act" if summary.methods[name].guarded else "Unguarded, it acted"
    return f" {who} in {found.acted} of {counted(found.asked, 'outage')}."


def _reached(share: OracleShare | None, baseline: str) -> str:
    if share is None:
        return ""
    if share.unknown_because:
        return f" What share of the oracle's gain that is cannot be told: {share.unknown_because}."
    interval = (
        f" (95 % interval {share.low_percent:.0f} to {share.high_percent:.0f} %)"
        if math.isfinite(share.low_percent + share.high_percent)
        else ""
    )
    reached = f"{share.share_percent:.0f} %{interval}".replace("-", "−")
    return f" Of what the oracle gains over **{baseline}** it reached {reached}."


def _whose_gain(name: str, baseline: str, first: str, found: Found) -> str:
    """Return a warning where a gain over a weak baseline is that of the filter underneath."""
    if found[baseline][name].verdict != "helps":
        return ""
    if found[first][name].verdict == "helps" or found[baseline][first].verdict != "helps":
        return ""
    gain = percent(found[baseline][first].improvement_percent)
    return f" But **{first}** alone gains {gain} there: this is no merit of what was learned."


def _best(summary: RunSummary) -> str:
    names = real_time(summary.methods)
    medians = {name: averages(summary.rows, name, summary.metric).median for name in names}
    medians = {name: value for name, value in medians.items() if math.isfinite(value)}
    if not medians:
        return "No method finished an outage."
    low, high = min(medians.values()), max(medians.values())
    best, worst = (
        " and ".join(f"**{name}**" for name, value in medians.items() if value == edge)
        for edge in (low, high)
    )
    everybody = len(names) == len(summary.methods)
    the = "The" if everybody else "Of the methods that run while the car drives, the"
    return (
        f"{the} smallest median is that of {best} ({with_unit(low, summary.metric)}), the "
        f"largest that of {worst} ({with_unit(high, summary.metric)}), by "
        f"`{summary.metric}`. A smallest median alone is no verdict: the comparisons are."
    )


def _bounds(summary: RunSummary, baseline: str, found: dict[str, Comparison]) -> list[str]:
    """Return what post-processing and oracles gain: to measure by, no competitors."""
    whose = {
        "post-processing": "It knows what came after the outage, so it is no competitor.",
        "oracle": "It is an oracle: it knows what no car can, and only marks a bound.",
    }
    return [
        f"{sentence(name, baseline, found[name])} {whose[role]}"
        for wanted in whose
        for name, role in roles(summary.methods).items()
        if role == wanted and name in found
    ]


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
