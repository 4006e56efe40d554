"""The part of a report that sets methods side by side."""

from navlearn.outages.markdown import markdown_table, number, signed
from navlearn.outages.naming import axis_label
from navlearn.outages.run_summary import RunSummary, comparisons
from navlearn.outages.statistics import Comparison, averages
from navlearn.outages.wording import BASELINE_VERDICTS

REGIMES = {
    "none": "nothing is learned",
    "online": "learned on this drive, anew for each outage, from what lies before it",
    "other-drives": "learned on other drives, then frozen",
    "adapted": "learned on other drives, then adapted to what lies before each outage",
}
"""Training regimes in words."""

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
    table = {name: averages(summary.rows, name, summary.metric) for name in summary.methods}
    out = [
        f"By `{summary.metric}`: {axis_label(summary.metric)} of each outage, then the mean, "
        "median and 90th percentile over the outages.\n"
    ]
    out.append(
        markdown_table(
            ("method", "training", "outages", "failed", "mean", "median", "90 %"),
            [
                (
                    name,
                    about.regime,
                    str(table[name].outages),
                    str(table[name].failed),
                    *(number(v) for v in (table[name].mean, table[name].median, table[name].p90)),
                )
                for name, about in summary.methods.items()
            ],
        )
    )
    out += [f"- **{name}**: {about.description}" for name, about in summary.methods.items()]
    out += [f"- {name}: {note}" for name, about in summary.methods.items() for note in about.notes]
    used = dict.fromkeys(about.regime for about in summary.methods.values())
    out += [f"- Training `{regime}`: {REGIMES[regime]}." for regime in used if regime in REGIMES]
    for baseline in summary.baselines:
        found = comparisons(summary, baseline)
        if found:
            out += [f"\n### Against `{baseline}`\n", _comparison_table(summary, found)]
    out += ["\n### Other figures (median over outages)\n", _other_figures(summary)]
    return out


def _comparison_table(summary: RunSummary, found: dict[str, Comparison]) -> str:
    header = (
        "method", "improvement %", "95 % interval", "better in", "sign test p",
        "over 10 % worse in", "verdict",
    )  # fmt: skip
    lines = [
        (
            name,
            signed(one.improvement_percent),
            f"{signed(one.low_percent)} to {signed(one.high_percent)}",
            f"{one.wins} of {one.pairs}" + (f", {one.ties} equal" if one.ties else ""),
            f"{one.sign_test_p:.3f}",
            str(one.harm_count),
            _verdict(summary, name, one),
        )
        for name, one in found.items()
    ]
    drawn = {f"{one.units} {one.drawn_by}s" for one in found.values()}
    note = (
        "Improvement: by how much the mean error is smaller than the baseline's (negative: "
        f"larger); paired bootstrap drawn from {' / '.join(sorted(drawn))}. A verdict is given "
        "only where the interval excludes zero.\n"
    )
    return markdown_table(header, lines) + "\n" + note


def _verdict(summary: RunSummary, name: str, found: Comparison) -> str:
    if summary.methods[name].regime == "none":
        return BASELINE_VERDICTS.get(found.verdict, "no evidence")
    if found.pairs and found.ties == found.pairs and found.failed == 0:
        return "never acted"
    return found.verdict


def _other_figures(summary: RunSummary) -> str:
    shown = [name for name in OTHER_FIGURES if summary.rows[name].notna().any()]
    medians = summary.rows.groupby("method")[shown].median()
    table = markdown_table(
        ("figure", *summary.methods),
        [
            (f"`{name}`", *(number(medians.loc[method, name]) for method in summary.methods))
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
