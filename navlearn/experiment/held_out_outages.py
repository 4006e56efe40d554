"""What a tuned filter gains in outages of held-out data: what navigation is judged by.

Outages are emulated on the held-out stretches by the ordinary protocol and replayed causally with
the recipe's filter and with the tuned one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd

from navlearn.errors import LogError
from navlearn.experiment.baselines import FilterRuns
from navlearn.experiment.methods import build_methods
from navlearn.experiment.tuning_drives import Stretch
from navlearn.outages.placement import place_outages
from navlearn.outages.replay import replay
from navlearn.outages.schedule import Outage, OutageProtocol
from navlearn.outages.statistics import compare_columns, error_table
from navlearn.recipe import Recipe
from navlearn.recipe.tuned_spec import TunedSpec

UNTUNED, TUNED = "ekf", "ekf+tuned"

FEWEST = 10
"""So many outages are placed on a held-out stretch, or as many as fit, if the recipe has fewer."""


@dataclass(frozen=True, kw_only=True)
class OutageGain:
    """Largest horizontal error through held-out outages, tuned against untuned.

    Attributes:
        duration: Length of the outages, s.
        count: Outages that both filters finished.
        before: Mean of the untuned filter, m.
        after: Mean of the tuned filter, m.
        improvement: By how much the mean error is smaller, %.
        low: Lower end of the interval of 95 %; NaN for a single outage.
        high: Upper end.
        failed: Outages that only the untuned filter finished.
    """

    duration: float
    count: int
    before: float
    after: float
    improvement: float
    low: float
    high: float
    failed: int

    @property
    def not_worse(self) -> bool:
        """Whether the mean error is no larger, and no outage was lost."""
        return self.improvement >= 0.0 and self.failed == 0

    @property
    def words(self) -> str:
        """The figures in words."""
        ends = (
            f"({self.low:+.1f} to {self.high:+.1f}, 95 %)"
            if math.isfinite(self.low)
            else "(no interval)"
        )
        lost = f", {self.failed} more not finished" if self.failed else ""
        return (
            f"largest error of {self.count} held-out outages of {self.duration:g} s "
            f"{self.before:.2f} -> {self.after:.2f} m, {self.improvement:+.1f} % {ends}{lost}"
        )


def held_out_outages(
    recipe: Recipe, stretches: Sequence[Stretch], tuned: TunedSpec
) -> OutageGain | None:
    """Return the gain in outages of what is held out.

    Args:
        recipe: Its filter is the untuned one; its ``outages`` tell the protocol.
        stretches: Drives of which a part, or all, is held out.
        tuned: What was tuned.

    Returns:
        The gain; None where no outage fits into what is held out.
    """
    both = recipe.model_copy(update={"tuned": tuned, "methods": (UNTUNED, TUNED), "models": ()})
    tables = []
    for k, stretch in enumerate(stretches):
        outages = outages_of(recipe.outages.protocol(), stretch)
        if outages:
            methods = build_methods(both, runs=FilterRuns(both, growing=True))
            rows = replay(stretch.log, outages, methods, progress=False).rows
            # two logs may have the same name
            tables.append(rows.assign(drive=f"{k}"))
    if not tables:
        return None
    return outage_gain(pd.concat(tables, ignore_index=True), recipe.outages.duration_s)


def outages_of(protocol: OutageProtocol, stretch: Stretch) -> tuple[Outage, ...]:
    """Return outages spread over what is held out of a drive.

    Args:
        protocol: Rules and length of outages.
        stretch: The drive. Where a part of it was tuned on, outages begin after that part; else
            after the protocol's own warm-up.

    Returns:
        Outages in order of time; none where none fits.
    """
    partly = stretch.tuned_until > stretch.begin
    warm_up = stretch.tuned_until - stretch.begin if partly else protocol.warm_up
    spread = replace(
        protocol,
        placement="spread",
        times=(),
        count=max(protocol.count, FEWEST),
        fewer=True,
        warm_up=warm_up,
        satellites=0,
        min_satellites=0,
        visible="highest",
        visible_satellites=(),
    )
    try:
        return place_outages(spread, stretch.log).outages
    except LogError:
        return ()


def outage_gain(rows: pd.DataFrame, duration: float) -> OutageGain:
    """Return the gain that rows of outages tell, with a paired bootstrap interval.

    Args:
        rows: Table of outages of both filters, as ``outages.csv``.
        duration: Length of the outages, s.
    """
    errors = error_table(rows)
    found = compare_columns(errors, TUNED, UNTUNED)
    mean = errors.dropna().mean()
    return OutageGain(
        duration=duration,
        count=found.pairs,
        before=float(mean[UNTUNED]),
        after=float(mean[TUNED]),
        improvement=found.improvement_percent,
        low=found.low_percent,
        high=found.high_percent,
        failed=found.failed,
    )
