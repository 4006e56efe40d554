"""What is believed at all blocks at once, from what a filter over all of them predicted.

The rules are those of :mod:`navlearn.fusion.tight.integrity`. Those that remember nothing are asked
of all blocks together. The others, which need the refusals before, are asked only where something
was refused; what they say may change the refusals of later blocks, so they are asked again until
nothing changes.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import projected
from navlearn.filters.tight_belief import TightBelief, map_tree
from navlearn.fusion.gated_pass import same_said
from navlearn.fusion.gating import Judged, nis_by_kind
from navlearn.fusion.gating_over_time import judged_over_time
from navlearn.fusion.integrity import position_faults
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict, believed
from navlearn.fusion.tight.integrity import (
    Hypothesis,
    RangesJudged,
    Scene,
    groups,
    judged_with_patience,
    many_refused,
    plainly_judged,
)
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.packing import Places
from navlearn.fusion.tight.update import vouching

ROUNDS = 8
"""How often at most the rules that remember refusals are asked again."""


class Said(NamedTuple):
    """What is believed at all blocks, shape (B, K, ...) each.

    Attributes:
        ranges: Of the ranges, at their places; refusals of all slots.
        own: Of what the vehicle measures of itself.
        opened: Variance added where something begins anew, shape (B, K, n + c).
    """

    ranges: RangesJudged
    own: Judged
    opened: Tensor


def same(said: Said, other: Said, nearly: float) -> bool:
    """Return whether the same is believed: verdicts and weights alike, and clocks set alike.

    Args:
        said: What is believed.
        other: What was believed before.
        nearly: By how much clocks may be set differently, m or m/s.
    """
    alike = (said.ranges.verdict == other.ranges.verdict).all()
    moved = (said.ranges.anew.shift - other.ranges.anew.shift).abs().amax()
    return bool(alike & (moved <= nearly)) and same_said(said.own, other.own)


def ranges_judged_over_time(
    model: TightModel, found: Measured, covariance: Tensor, refused: Tensor, places: Places
) -> RangesJudged:
    """Return what is believed of the ranges at all blocks.

    Args:
        model: The filter.
        found: What is measured, at places, shape (B, K).
        covariance: P of error states and surprises before updates, shape (B, K, N, N).
        refused: Refusals before the first block, of slots, shape (B, 2 S + 2).
        places: Which satellite stands where.

    Returns:
        Verdicts; refusals are those of slots.
    """
    scene, plain = plainly_judged(model, found, covariance)
    there = scene.there
    odd = (there & ~plain.accepted).any(-1)
    before, counted = _counted(refused, there, plain.accepted, places)
    said = _of_plain(scene, plain, before)
    if not bool(odd.any()):
        return said._replace(refused=counted)
    some = Scene(model, *map_tree(tuple(scene[1:]), lambda x: x[odd]))
    thought: Hypothesis = map_tree(plain, lambda x: x[odd])
    here = Places(places.slot[odd], places.slots)
    for _ in range(ROUNDS):
        part = judged_with_patience(some, thought, here.packed_counts(before[odd]))
        new = _with_part(said, part, odd)
        before, counted = _counted(refused, there, believed(new.verdict), places)
        done = torch.equal(new.verdict, said.verdict) and torch.equal(new.reset, said.reset)
        said = new
        if done:
            break
    return said._replace(refused=counted)


def own_judged_over_time(
    model: TightModel, own: Measured, prior: TightBelief[Any], refused: Tensor, ranges: RangesJudged
) -> Judged:
    """Return what is believed of what the vehicle measures of itself, at all blocks.

    Args:
        model: The filter.
        own: What the vehicle measures, shape (B, K).
        prior: Prediction, batch shape (B, K); its refusals are not used.
        refused: Refusals before the first block, shape (B, kinds).
        ranges: What is believed of the ranges.

    Returns:
        Verdicts per kind.
    """
    vehicle, n = model.vehicle, model.first_clock
    _, spread = projected(prior.covariance[..., :n, :n], own.observation)
    nis = nis_by_kind(vehicle, own, own.innovation, spread)
    faults = position_faults(vehicle.gate, vehicle.rows, own)
    if vehicle.anchor is None:
        return judged_over_time(vehicle, nis, own.present, refused, faults=faults)
    vouched, unheard = vouching(model, own, ranges)
    return judged_over_time(
        vehicle, nis, own.present, refused, faults=faults, vouched=vouched, unheard=unheard
    )


def _of_plain(scene: Scene, plain: Hypothesis, before: Tensor) -> RangesJudged:
    """Return what is believed where nothing is refused; elsewhere it is still to be asked."""
    none = scene._replace(there=scene.there & plain.accepted)
    places = before[..., :1].expand(*before.shape[:-1], scene.there.shape[-1] + 2)
    said = judged_with_patience(none, plain, places)
    verdict = torch.where(scene.there & ~plain.accepted, int(Verdict.REFUSED_BY_GATE), said.verdict)
    return said._replace(verdict=verdict)


def _with_part(said: RangesJudged, part: RangesJudged, odd: Tensor) -> RangesJudged:
    def put(whole: Tensor, some: Tensor) -> Tensor:
        new = whole.clone()
        new[odd] = some.to(new)
        return new

    return RangesJudged(
        put(said.nis, part.nis),
        put(said.verdict, part.verdict),
        said.refused,
        type(said.anew)(*map(put, said.anew, part.anew)),
        put(said.reset, part.reset),
    )


def _counted(
    refused: Tensor, there: Tensor, accepted: Tensor, places: Places
) -> tuple[Tensor, Tensor]:
    """Return refusals before and after each block, of all slots, shape (B, K, 2 S + 2)."""
    out = places.spread((there & ~accepted).to(refused), 0.0)
    fine = places.spread((there & accepted).to(refused), 0.0)
    most = many_refused(there, accepted)
    rest = groups(there).any(-1) & ~most
    out = torch.cat((out, most.to(refused)), -1)
    fine = torch.cat((fine, rest.to(refused)), -1)
    total = torch.cumsum(out, 1)
    since = torch.where(fine > 0.5, total, -refused.unsqueeze(1)).cummax(1).values
    after = total - since
    return torch.cat((refused.unsqueeze(1), after[:, :-1]), 1), after
