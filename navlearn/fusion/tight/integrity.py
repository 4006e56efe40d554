"""Which satellites are believed, and when the clock or the position begins anew.

At a reception, in this order:

1. A bias or an offset between systems less certain than ``unknown_clock`` is set to the median of
   the innovations that show it: what is unknown is no reason to refuse.
2. Pseudoranges and range rates that agree neither with the prediction nor with each other are
   refused, worst first (:mod:`navlearn.fusion.tight.agreement`). Most receptions end here. A
   satellite is never reset for itself: one that is wild stays refused as long as it is.
3. Where most pseudoranges are refused the clock may have jumped: it is moved by the median of the
   innovations, its bias begins anew, and all are judged again; where most range rates are refused,
   likewise the drift. A jump is believed if more measurements agree then, and of the kind that
   jumped most. That holds at once for at least two satellites and a median beyond ``smallest_jump``
   (``smallest_drift_jump``; a drift that jumps takes the bias along), else after *patience*: many,
   two and a third at least or the only one, were refused in ``reset_after`` receptions before. The
   offset of a system begins anew where most of its satellites are refused, each ``reset_after``
   times before. Position is not touched: its covariance stays, and a clock that begins anew takes
   up what all ranges share.
4. After patience, and where no jump is believed, the filter may have drifted: position, clock,
   velocity states and azimuth begin anew. It has if at least two more pseudoranges agree then, and
   as many as position and clock need, ``least_satellites`` and one for each further system, and
   ``redundant`` more or all; where there are no more than they need, which always agree, also most
   must have been refused. Range rates refused for as long open drift, velocity states and azimuth
   by the same rule.

With three satellites and fewer, ranges alone never move a position by force.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.anew import Anew, Flags, begun_anew, clock_set, common, told_by_clock
from navlearn.fusion.tight.clock import BIAS, DRIFT
from navlearn.fusion.tight.hypotheses import Hypothesis as Hypothesis
from navlearn.fusion.tight.hypotheses import Scene as Scene
from navlearn.fusion.tight.hypotheses import chosen, more_agree, most_refused, what_agrees
from navlearn.fusion.tight.hypotheses import groups as groups
from navlearn.fusion.tight.hypotheses import many_refused as many_refused
from navlearn.fusion.tight.model import TightModel


class RangesJudged(NamedTuple):
    """What is believed of one reception.

    Attributes:
        nis: NIS of each measurement against the prediction, the clock set where it was unknown;
            NaN where there is none, shape (..., 2 S).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, int64, shape (..., 2 S).
        refused: Refusals afterwards, as in ``TightBelief``, shape (..., 2 S + 2).
        anew: What is set and what begins anew.
        reset: Whether position and clock begin anew, and whether the clock does and position does
            not, bool, shape (..., 2).
    """

    nis: Tensor
    verdict: Tensor
    refused: Tensor
    anew: Anew
    reset: Tensor


def judged_ranges(
    model: TightModel, found: Measured, covariance: Tensor, refused: Tensor
) -> RangesJudged:
    """Return what is believed of one reception.

    Args:
        model: The filter.
        found: What is measured, shape (...).
        covariance: P of error states and surprises before the update, shape (..., N, N).
        refused: Refusals before, shape (..., 2 S + 2).

    Returns:
        Verdicts, and what begins anew.
    """
    scene, plain = plainly_judged(model, found, covariance)
    return judged_with_patience(scene, plain, refused)


def plainly_judged(
    model: TightModel, found: Measured, covariance: Tensor
) -> tuple[Scene, Hypothesis]:
    """Return what agrees if nothing begins anew: rules 1 and 2, which remember nothing.

    Args:
        model: The filter.
        found: What is measured, shape (...).
        covariance: P of error states and surprises before the update, shape (..., N, N).

    Returns:
        What receptions are judged by, and what agrees.
    """
    there = found.present > 0.5
    H = found.observation.detach()
    spread = H @ covariance.detach() @ H.transpose(-1, -2)
    spread = 0.5 * (spread + spread.transpose(-1, -2)) + torch.diag_embed(found.variance.detach())
    variance = covariance.detach().diagonal(dim1=-2, dim2=-1)
    scene = Scene(model, found, spread, there)
    return scene, what_agrees(scene, clock_set(model, found, variance, there))


def judged_with_patience(scene: Scene, plain: Hypothesis, refused: Tensor) -> RangesJudged:
    """Return what is believed of one reception: rules 3 and 4, which remember refusals.

    Args:
        scene: What it is judged by, shape (...).
        plain: What agrees if nothing begins anew.
        refused: Refusals before, shape (..., 2 S + 2).

    Returns:
        Verdicts, and what begins anew.
    """
    there, taken = scene.there, plain
    reset = torch.zeros_like(there[..., :2])
    if bool((there & ~plain.accepted).any()):
        taken, reset = _best(scene, plain, refused)
    left = scene.found.innovation - told_by_clock(scene.model, scene.found, plain.anew.shift)
    nis = left * left / scene.spread.diagonal(dim1=-2, dim2=-1)
    good = torch.where(reset.any(-1), int(Verdict.ACCEPTED_BY_RESET), int(Verdict.ACCEPTED))
    verdict = torch.where(taken.accepted, good.unsqueeze(-1), int(Verdict.REFUSED_BY_GATE))
    return RangesJudged(
        torch.where(there, nis, torch.nan),
        torch.where(there, verdict, int(Verdict.ABSENT)),
        _counted(refused, there, taken.accepted),
        taken.anew,
        reset,
    )


def _best(scene: Scene, plain: Hypothesis, refused: Tensor) -> tuple[Hypothesis, Tensor]:
    """Return the hypothesis that is believed, and which of the two resets it is."""
    patient = refused[..., -2:] >= scene.model.options.gate.reset_after
    best, jumped = plain, torch.zeros_like(patient[..., 0])
    flags = _clock_flags(scene, plain, patient, refused)
    if bool(flags.clock.any()):
        supposed = what_agrees(scene, _anew(scene, plain, flags))
        jumped = _jumped(scene, plain, supposed, flags, patient)
        best = chosen(jumped, supposed, best)
    flags = _drift_flags(scene, plain, patient & ~jumped.unsqueeze(-1))
    if not bool(flags.motion.any()):
        return best, torch.stack((torch.zeros_like(jumped), jumped), -1)
    supposed = what_agrees(scene, _anew(scene, plain, flags))
    drifted = _drifted(scene, plain, supposed, flags)
    reset = torch.stack((drifted & flags.position, jumped | (drifted & ~flags.position)), -1)
    return chosen(drifted, supposed, best), reset


def _anew(scene: Scene, plain: Hypothesis, flags: Flags) -> Anew:
    return begun_anew(scene.model, scene.found, scene.there, plain.anew, flags)


def _clock_flags(scene: Scene, plain: Hypothesis, patient: Tensor, refused: Tensor) -> Flags:
    """Return which clock states may have jumped."""
    model, there = scene.model, scene.there
    count = there.shape[-1] // 2
    lost = most_refused(there, plain.accepted)
    seen, out = there[..., :count], (there & ~plain.accepted)[..., :count]
    waited = refused[..., :count] >= model.options.gate.reset_after
    rates = common(scene.found.innovation[..., count:], there[..., count:]).detach().abs()
    far = (rates > model.options.gate.smallest_drift_jump) & (there[..., count:].sum(-1) >= 2)
    flags = [lost[..., 0], lost[..., 1] & (far | patient[..., 1])]
    by_clock = scene.found.observation[..., :count, model.first_clock : model.size]
    for j in range(DRIFT + 1, by_clock.shape[-1]):
        own = by_clock[..., j] > 0.5
        most = 2 * (out & own).sum(-1) > (seen & own).sum(-1)
        flags.append(most & ~(out & own & ~waited).any(-1))
    none = torch.zeros_like(lost[..., 0])
    return Flags(torch.stack(flags, -1), none, none)


def _jumped(
    scene: Scene, plain: Hypothesis, supposed: Hypothesis, flags: Flags, patient: Tensor
) -> Tensor:
    """Return whether a jump of the clock is believed."""
    gate, (bias, drift) = scene.model.options.gate, (flags.clock[..., k] for k in (BIAS, DRIFT))
    agreed = groups(supposed.accepted).sum(-1)[..., 0]
    moved = (supposed.anew.shift - plain.anew.shift)[..., BIAS].detach().abs()
    visible = (agreed >= 2) & ((moved > gate.smallest_jump) | drift)
    most = 2 * groups(supposed.accepted).sum(-1) > groups(scene.there).sum(-1)
    fine = (visible | patient[..., 0]) & most[..., 0]
    return (
        flags.clock.any(-1) & (fine | ~bias) & (most[..., 1] | ~drift) & more_agree(supposed, plain)
    )


def _drift_flags(scene: Scene, plain: Hypothesis, patient: Tensor) -> Flags:
    """Return where the filter may have drifted."""
    seen, needed = groups(scene.there).sum(-1), _needed(scene)
    enough = (seen > needed) | most_refused(scene.there, plain.accepted)
    lost = many_refused(scene.there, plain.accepted) & (seen >= needed) & enough & patient
    position, motion = lost[..., 0], lost.any(-1)
    clock = torch.zeros_like(plain.anew.shift, dtype=torch.bool) | position.unsqueeze(-1)
    clock[..., DRIFT] = motion
    return Flags(clock, motion, position)


def _drifted(scene: Scene, plain: Hypothesis, supposed: Hypothesis, flags: Flags) -> Tensor:
    """Return whether it is believed that the filter has drifted."""
    before, after, seen = (
        groups(x).sum(-1) for x in (plain.accepted, supposed.accepted, scene.there)
    )
    wanted = torch.minimum(seen, _needed(scene) + scene.model.options.gate.redundant)
    fine = (after >= wanted) & (after >= before + 2)
    asked = torch.where(flags.position, fine[..., 0], fine[..., 1])
    return flags.motion & asked & more_agree(supposed, plain)


def _needed(scene: Scene) -> Tensor:
    """Return how many pseudoranges, and range rates, tell what begins anew, shape (..., 2)."""
    count, first = scene.there.shape[-1] // 2, scene.model.first_clock + DRIFT + 1
    further = scene.found.observation[..., :count, first : scene.model.size] > 0.5
    ranges = further.any(-2).sum(-1) + scene.model.options.gate.least_satellites
    rates = torch.full_like(ranges, scene.model.options.gate.least_satellites)
    return torch.stack((ranges, rates), -1)


def _counted(refused: Tensor, there: Tensor, accepted: Tensor) -> Tensor:
    """Return refusals after a reception; what is not measured keeps its count."""
    single, group = refused[..., :-2], refused[..., -2:]
    out = there & ~accepted
    single = torch.where(out, single + 1.0, torch.where(there, 0.0, single))
    many, any_there = many_refused(there, accepted), groups(there).any(-1)
    group = torch.where(many, group + 1.0, torch.where(any_there, 0.0, group))
    return torch.cat((single, group), -1)
