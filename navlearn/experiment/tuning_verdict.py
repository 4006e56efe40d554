"""Whether to take what was tuned: by held-out likelihood and by held-out outages.

Likelihood from second to second takes errors of fixes that last for precision, and for motion of
the car, so that a filter may become likelier and worse. What users care for is where the car is
when fixes are missing. Tuned noise is recommended where the interval of 95 % of its gain in
log-likelihood lies above zero, and the mean of the largest errors through held-out outages is no
larger than before, all of them finished. That is a rule to refuse harm by: few outages prove no
gain, and their interval is told.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from navlearn.experiment.baselines import filter_options
from navlearn.experiment.held_out_gain import HeldOutGain, held_out_gain
from navlearn.experiment.held_out_outages import OutageGain, held_out_outages
from navlearn.experiment.tuning_drives import Stretch, laid_out
from navlearn.fusion.options import EkfOptions
from navlearn.learning.held_out import HeldOutStretch, held_out_scores
from navlearn.learning.noise_options import TuningOptions
from navlearn.recipe import Recipe
from navlearn.recipe.tuned_spec import TunedSpec

UNJUDGED = "nothing was held out, so nothing was judged: not recommended, nor advised against"


@dataclass(frozen=True, kw_only=True)
class TuningVerdict:
    """What held-out data say of a tuned filter.

    Attributes:
        likelihood: Gain in log-likelihood.
        outages: Gain in outages; None where none fits into what is held out.
        duration: Length that outages were to have, s.
        spacing: Time between the fixes that were foretold, s; 0 for all of them.
    """

    likelihood: HeldOutGain
    outages: OutageGain | None
    duration: float
    spacing: float = 0.0

    @property
    def objections(self) -> tuple[str, ...]:
        """What speaks against taking it; nothing where it is recommended."""
        found = []
        if math.isnan(self.likelihood.low):
            found.append("too little is held out to tell the likelihood")
        elif not self.likelihood.better:
            worse = self.likelihood.high < 0.0
            found.append("the likelihood is worse" if worse else "no clear gain in likelihood")
        if self.outages is None:
            found.append(f"no outage of {self.duration:g} s fits into what is held out")
        elif not self.outages.not_worse:
            found.append("outages are worse")
        return tuple(found)

    @property
    def recommended(self) -> bool:
        """Whether the likelihood clearly gains and outages are not worse."""
        return not self.objections

    @property
    def words(self) -> str:
        """The verdict with both figures."""
        apart = f", fixes {self.spacing:g} s apart" if self.spacing > 0.0 else ""
        told = self.likelihood.words + apart
        told += "" if self.outages is None else f"; {self.outages.words}"
        if self.recommended:
            return f"recommended: the likelihood gains and outages are not worse: {told}"
        return f"not recommended: {' and '.join(self.objections)}: {told}"

    @property
    def figures(self) -> dict[str, Any]:
        """Figures of a tuned spec."""
        like, out = self.likelihood, self.outages
        numbers = {
            "held_out_nats_per_s": _rounded(
                before=like.before,
                after=like.after,
                gain=like.gain,
                gain_low=like.low,
                gain_high=like.high,
                spacing_s=self.spacing,
            ),
            "held_out_windows": like.windows,
            "held_out_s": round(like.seconds, 1),
        }
        if out is not None:
            numbers["held_out_outages"] = _rounded(
                duration_s=out.duration,
                count=out.count,
                failed=out.failed,
                before_m=out.before,
                after_m=out.after,
                gain_percent=out.improvement,
                gain_percent_low=out.low,
                gain_percent_high=out.high,
            )
        return {**numbers, "recommended": int(self.recommended)}


def judged(
    recipe: Recipe,
    stretches: Sequence[Stretch],
    before: EkfOptions,
    found: dict[str, Any],
    tuning: TuningOptions,
) -> TuningVerdict | None:
    """Return what the held-out parts of drives say of tuned options.

    Args:
        recipe: The recipe whose filter was tuned.
        stretches: Drives, and which part of them was tuned on.
        before: The recipe's filter.
        found: What was tuned, as a tuned spec's ``filter``.
        tuning: How innovations are judged.

    Returns:
        The verdict; None where nothing is held out.

    Raises:
        LogError: A drive cannot be used.
        FilterDivergedError: A filter is lost on what is held out.
    """
    judging = [stretch for stretch in stretches if stretch.judges]
    if not judging:
        return None
    spec = TunedSpec(filter=found)
    tuned = recipe.model_copy(update={"filter": spec.laid_over(recipe.filter)})
    after = filter_options(tuned, log=judging[0].log)
    parts = []
    for stretch in judging:
        drive, start_time = laid_out(stretch.log, recipe)
        parts.append(HeldOutStretch(drive=drive, after=stretch.tuned_until - start_time))
    scores = held_out_scores(
        parts,
        before,
        after,
        window=tuning.window,
        likelihood=tuning.likelihood,
        spacing=tuning.spacing,
    )
    return TuningVerdict(
        likelihood=held_out_gain(scores),
        outages=held_out_outages(recipe, judging, spec),
        duration=recipe.outages.duration_s,
        spacing=tuning.spacing,
    )


def _rounded(**numbers: float) -> dict[str, int | float]:
    return {
        name: round(value, 4) if isinstance(value, float) else value
        for name, value in numbers.items()
        if math.isfinite(value)
    }
