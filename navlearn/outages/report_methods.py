"""The part of a report that sets methods side by side."""

from collections.abc import Callable, Mapping, Sequence

from navlearn.outages.acting import safeguard_section
from navlearn.outages.markdown import markdown_table, number, signed
from navlearn.outages.meaning import oracle_shares
from navlearn.outages.naming import axis_label
from navlearn.outages.oracle_share import OracleShare
from navlearn.outages.roles import Role, having, roles, verdict_words
from navlearn.outages.run_summary import MethodSummary, RunSummary, comparisons
from navlearn.outages.statistics import MARGIN_PERCENT, Comparison, averages
from navlearn.outages.wording import MARGIN_WHY, never_differs, percent

REGIMES = {
    "none": "nothing is learned",
    "online": "learned on this drive, anew for each outage, from what lies before it",
    "other-drives": "learned on other drives, then frozen",
    "tuned": "noise found on other drives or on an earlier part of this one, then frozen",
    "adapted": "learned on other drives, then adapted to what lies before each outage",
    "post-processing": (
        "nothing is learned, but the fixes after each outage are seen, none inside it: for work "
        "on recorded drives, not a real-time method"
    ),
    "oracle": "nothing is learned, but what no car can know is seen: a bound, not a competitor",
}
"""Training regimes in words."""

GROUPS: tuple[tuple[tuple[Role, ...], str], ...] = (
    (("baseline", "learned"), ""),
    (("post-processing",), "Post-processing, which knows what came after; no competitor:"),
    (("oracle",), "Oracles, which know what no car can; bounds, no competitors:"),
)
"""Methods that are shown in one table, and what stands above it."""

OTHER_FIGURES = (
    "rms_horizontal_error_m",
    "final_horizontal_error_m",
    "final_horizontal_error_percent",
    "max_azimuth_error_deg",
    "max_height_error_m",
    "max_velocity_error_m_per_s",
    "rms_along_track_error_m",
    "rms_cross_track_error_m",
    "share_in_95_ellipse",
)


def methods_section(summary: RunSummary) -> list[str]:
    """Return averages, comparisons with every baseline, and other figures, as Markdown.

    Args:
        summary: The run.
    """
    out = [
        f"By `{summary.metric}`: {axis_label(summary.metric)} of each outage, then the mean, "
        "median and 90th percentile over the outages.\n",
        *_by_group(summary, list(summary.methods), _averages_table),
        *described(summary.methods),
    ]
    shares = oracle_shares(summary)
    present = [name for name in summary.baselines if name in summary.methods]
    for baseline in present:
        first = baseline == present[0]
        found = comparisons(summary, baseline)
        if found:
            out += [f"\n### Against `{baseline}`\n"]
            out += _comparison_tables(summary, found, shares if first else {}, explained=first)
    out += safeguard_section(summary.rows, list(summary.methods))
    out += ["\n### Other figures (median over outages)\n", _other_figures(summary)]
    return out


def described(methods: Mapping[str, MethodSummary]) -> list[str]:
    """Return what the methods are, their notes, and what their training means, as a list.

    Args:
        methods: The methods.
    """
    out = [f"- **{name}**: {about.description}" for name, about in methods.items()]
    out += [f"- {name}: {note}" for name, about in methods.items() for note in about.notes]
    used = dict.fromkeys(about.regime for about in methods.values())
    known = [regime for regime in used if regime in REGIMES]
    return out + [f"- Training `{regime}`: {REGIMES[regime]}." for regime in known]


def in_order(summary: RunSummary) -> list[str]:
    """Return the methods of a run with those behind that do not compete.

    Args:
        summary: The run.
    """
    return [name for wanted, _ in GROUPS for name in having(summary.methods, *wanted)]


def _by_group(
    summary: RunSummary, names: Sequence[str], table: Callable[[RunSummary, list[str]], str]
) -> list[str]:
    """Return a table of the competitors, and one each of those that are not, with a heading."""
    out = []
    for wanted, heading in GROUPS:
        mine = [name for name in having(summary.methods, *wanted) if name in names]
        if mine:
            out += [f"{heading}\n"] if heading else []
            out.append(table(summary, mine))
    return out


def _averages_table(summary: RunSummary, names: list[str]) -> str:
    lines = []
    for name in names:
        found = averages(summary.rows, name, summary.metric)
        figures = (number(value) for value in (found.mean, found.median, found.p90))
        regime = summary.methods[name].regime
        lines.append((name, regime, str(found.outages), str(found.failed), *figures))
    return markdown_table(
        ("method", "training", "outages", "failed", "mean", "median", "90 %"), lines
    )


def _comparison_tables(
    summary: RunSummary,
    found: dict[str, Comparison],
    shares: Mapping[str, OracleShare],
    *,
    explained: bool,
) -> list[str]:
    def table(summary: RunSummary, names: list[str]) -> str:
        return _comparison_table(summary, {name: found[name] for name in names}, shares)

    drawn = {f"{one.units} {one.drawn_by}s" for one in found.values()}
    note = (
        "Improvement: by how much the mean error is smaller than the baseline's (negative: "
        f"larger); paired bootstrap drawn from {' / '.join(sorted(drawn))}. A method helps where "
        "the interval lies above zero, and harms where it lies below. It is harmless where all of "
        f"the interval lies above {percent(MARGIN_PERCENT)}: {MARGIN_WHY}. Anything else is no "
        "evidence.\n"
    )
    if shares:
        note += (
            "\nShare of the oracle: of the gain that knowing the deterministic sensor errors "
            "brings, with its 95 % interval; a dash where that gain is not clear of zero.\n"
        )
    return [*_by_group(summary, list(found), table), *([note] if explained else [])]


def _comparison_table(
    summary: RunSummary, found: dict[str, Comparison], shares: Mapping[str, OracleShare]
) -> str:
    header = [
        "method", "improvement %", "95 % interval", "better in", "sign test p",
        "over 10 % worse in", "verdict",
    ]  # fmt: skip
    played = roles(summary.methods)
    lines = [
        [
            name,
            signed(one.improvement_percent),
            f"{signed(one.low_percent)} to {signed(one.high_percent)}",
            f"{one.wins} of {one.pairs}" + (f", {one.ties} equal" if one.ties else ""),
            f"{one.sign_test_p:.3f}",
            str(one.harm_count),
            verdict_words(one.verdict, played[name], never_differs=never_differs(one)),
        ]
        for name, one in found.items()
    ]
    if shares:
        header.append("share of oracle %")
        lines = [[*line, share_words(shares.get(line[0]))] for line in lines]
    return markdown_table(header, lines)


def share_words(share: OracleShare | None) -> str:
    """Return a share with its interval, or a dash where there is none.

    Args:
        share: The share of the oracle's gain.
    """
    if share is None or share.unknown_because:
        return "–"
    ends = (share.low_percent, share.high_percent)
    shown = (number(value, 0) for value in (share.share_percent, *ends))
    return "{} ({} to {})".format(*shown)


def _other_figures(summary: RunSummary) -> str:
    shown = [name for name in OTHER_FIGURES if summary.rows[name].notna().any()]
    methods = in_order(summary)
    medians = summary.rows.groupby("method")[shown].median()
    table = markdown_table(
        ("figure", *methods),
        [
            (f"`{name}`", *(number(medians.loc[method, name]) for method in methods))
            for name in shown
        ],
    )
    if "share_in_95_ellipse" not in shown:
        return table
    return (
        f"{table}\n`share_in_95_ellipse` is the share of the outage in which the 95 % ellipse of "
        "the method's own covariance holds the car; far below 0.95 the method is surer than it "
        "should be.\n"
    )
