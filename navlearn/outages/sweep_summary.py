"""What a sweep over classes of sensors, durations and satellites hands to its report."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import pandas as pd

from navlearn.outages.cells import Cell
from navlearn.outages.published import PublishedTable
from navlearn.outages.run_summary import Chapter, MethodSummary
from navlearn.outages.statistics import HEADLINE


@dataclass(frozen=True, kw_only=True)
class SweepCell:
    """One class of gyros at one duration of outages and one number of satellites.

    Attributes:
        gyro_class: Name of the class, as in the rows' column ``gyro_class``.
        duration: Length of its outages, s, as in the rows' column ``duration_s``.
        drives: Names of its drives, as in the rows' column ``drive``.
        remark: What else is to be known of it, such as which drive the gyro was put on.
        satellites: Satellites whose ranges stay, as in the rows' column ``satellites``.
    """

    gyro_class: str
    duration: float
    drives: tuple[str, ...]
    remark: str = ""
    satellites: int = 0

    @property
    def key(self) -> Cell:
        """What its outages have in common."""
        return Cell(self.gyro_class, self.duration, self.satellites)


@dataclass(frozen=True, kw_only=True)
class SweepSummary:
    """Everything the report of a sweep tells.

    Attributes:
        title: Heading of the report.
        question: What the sweep asks, in a sentence or two.
        rows: Table of outages of all cells: the columns of ``outages.csv`` and ``gyro_class``.
        cells: The cells, in the order of the tables.
        methods: By name, in the order of the tables.
        command: How to run it again.
        versions: Of navlearn and what it stands on.
        seeds: By what they seed.
        classes: What each class stands for, in words, by name.
        published: Tables of papers, printed beside ours.
        remarks: Said before anything else, such as "simulated".
        setup: What was estimated or learned from what, a sentence each.
        wall_clock: Time the whole sweep took, s.
        processes: How many ran at once.
        baseline: Method that the others are compared with.
        also_against: Further ones, in the table by number of satellites.
        metric: Column by which methods are compared.
        resamples: Bootstrap draws.
        bootstrap_seed: Of the draws.
        figures: Captions of the figures by file name, relative to the report.
        chapters: What only some sweeps have, before the methods.
    """

    title: str
    question: str
    rows: pd.DataFrame
    cells: tuple[SweepCell, ...]
    methods: Mapping[str, MethodSummary]
    command: str
    versions: Mapping[str, str]
    seeds: Mapping[str, int] = field(default_factory=dict)
    classes: Mapping[str, str] = field(default_factory=dict)
    published: tuple[PublishedTable, ...] = ()
    remarks: tuple[str, ...] = ()
    setup: tuple[str, ...] = ()
    wall_clock: float | None = None
    processes: int = 1
    baseline: str = "ekf"
    also_against: tuple[str, ...] = ()
    metric: str = HEADLINE
    resamples: int = 5000
    bootstrap_seed: int = 0
    figures: Mapping[str, str] = field(default_factory=dict)
    chapters: tuple[Chapter, ...] = ()
