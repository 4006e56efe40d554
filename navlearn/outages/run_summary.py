"""What a run hands to its report, and how its methods compare."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import pandas as pd

from navlearn.outages.published import PublishedTable
from navlearn.outages.schedule import OutageProtocol, Placement
from navlearn.outages.statistics import HEADLINE, Comparison, compare_columns, error_table


@dataclass(frozen=True, kw_only=True)
class DriveSummary:
    """One drive of a run.

    Attributes:
        name: The drive's name, as in the rows' column ``drive``.
        source: Format and files it came from.
        duration: Length, s.
        distance: Driven, m.
        placement: Its outages.
        license: Licence of the data, empty where unknown.
        judged_by: ``reference``, ``truth`` or ``fixes``.
    """

    name: str
    source: str
    duration: float
    distance: float
    placement: Placement
    license: str = ""
    judged_by: str = "reference"


@dataclass(frozen=True, kw_only=True)
class MethodSummary:
    """One method of a run.

    Attributes:
        description: What it is, in a sentence.
        regime: ``none`` (nothing is trained), ``tuned``, ``online``, ``other-drives``,
            ``adapted``, or ``post-processing``, which knows what came after the outage.
        notes: Anything else worth reading, such as how often a safeguard spoke.
        guarded: Whether a safeguard stands between what was learned and the solution; of no
            meaning where nothing is learned.
    """

    description: str
    regime: str = "none"
    notes: tuple[str, ...] = ()
    guarded: bool = True


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A part of a report that only some runs have.

    Attributes:
        section: Lines of Markdown, a heading first.
        figures: Captions by file name, drawn below the text.
    """

    section: tuple[str, ...]
    figures: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """Everything a report tells.

    Attributes:
        title: Heading of the report.
        question: What the run asks, in a sentence or two.
        drives: The drives.
        protocol: How outages were placed.
        methods: By name, in the order of the tables.
        rows: Table of outages, as ``outages.csv``.
        command: How to run it again.
        versions: Of navlearn and what it stands on.
        seeds: By what they seed.
        baselines: Methods that the others are compared with.
        metric: Column by which methods are compared.
        remarks: Said before anything else, such as "semi-synthetic".
        setup: What was estimated or learned from what, a sentence each.
        resamples: Bootstrap draws.
        bootstrap_seed: Of the draws.
        figures: Captions of the figures by file name, relative to the report.
        published: Tables of papers, printed beside ours.
        chapters: What only some runs have, before the table of every outage.
    """

    title: str
    question: str
    drives: tuple[DriveSummary, ...]
    protocol: OutageProtocol
    methods: Mapping[str, MethodSummary]
    rows: pd.DataFrame
    command: str
    versions: Mapping[str, str]
    seeds: Mapping[str, int] = field(default_factory=dict)
    baselines: tuple[str, ...] = ("ekf", "ekf_plain")
    metric: str = HEADLINE
    remarks: tuple[str, ...] = ()
    setup: tuple[str, ...] = ()
    resamples: int = 5000
    bootstrap_seed: int = 0
    figures: Mapping[str, str] = field(default_factory=dict)
    published: tuple[PublishedTable, ...] = ()
    chapters: tuple[Chapter, ...] = ()


def comparisons(summary: RunSummary, baseline: str) -> dict[str, Comparison]:
    """Return every other method's comparison with a baseline, by the headline metric.

    Args:
        summary: The run.
        baseline: Name of the baseline; a run without it has no comparisons.
    """
    if baseline not in summary.methods:
        return {}
    errors = error_table(summary.rows, summary.metric)
    return {
        name: compare_columns(
            errors, name, baseline, resamples=summary.resamples, seed=summary.bootstrap_seed
        )
        for name in summary.methods
        if name != baseline
    }
