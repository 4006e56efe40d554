"""One reception: what the vehicle measures of itself and what ranges say, in one update."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import projected, update
from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.gating import Judged, judged, nis_by_kind, taken
from navlearn.fusion.integrity import position_faults
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict, believed
from navlearn.fusion.tight.anew import told_by_clock
from navlearn.fusion.tight.integrity import RangesJudged, judged_ranges
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.packing import Places
from navlearn.fusion.tight.ranges import variance_in_series
from navlearn.fusion.tight.seen import See, seen_linearly
from navlearn.fusion.tight.timeline import Reception


class TightEnded(NamedTuple):
    """One block's end, batch shape (B,).

    Attributes:
        prior: Belief before the update.
        belief: Belief after it.
        own_innovation: Innovation of what the vehicle measures of itself, shape (..., r).
        own: What the gate said of that.
        innovation: Innovation of pseudoranges, then of range rates, NaN for none, shape
            (..., 2 S).
        spread: Variance of these innovations, shape (..., 2 S).
        judged: What was believed of the ranges.
    """

    prior: TightBelief[Any]
    belief: TightBelief[Any]
    own_innovation: Tensor
    own: Judged
    innovation: Tensor
    spread: Tensor
    judged: RangesJudged


def updated(
    model: TightModel,
    prior: TightBelief[Any],
    block: Any,
    reception: Reception,
    places: Places,
    noise: TightNoise,
    see: See = seen_linearly,
) -> TightEnded:
    """Update with all that is measured at the end of a block.

    All innovations are against the prediction, and one update takes what is believed: what a
    vehicle measures of itself does not sway the judgement of ranges, nor they its.

    Args:
        model: The filter.
        prior: Prediction at the block's end, batch shape (...).
        block: The vehicle's side of the block.
        reception: What was received, at places, batch shape (...).
        places: Which satellite stands where, batch shape (...).
        noise: Noise of ranges.
        see: How what is measured is seen.

    Returns:
        The record of this end, errors fed back in its belief; satellites at places, but refusals
        in beliefs at slots.
    """
    vehicle = model.vehicle
    own, found, covariance = see(model, prior, block, reception, noise)
    ranges = judged_ranges(model, found, covariance, places.packed_counts(prior.refused))
    said = own_judged(model, own, covariance, prior, ranges)
    variance = ranges.anew.variance
    if bool((said.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        states = own._replace(observation=own.observation[..., : model.first_clock])
        opened = vehicle.opened(said.verdict, states, own.innovation)
        variance = variance + torch.nn.functional.pad(
            opened, (0, variance.shape[-1] - opened.shape[-1])
        )
    series = variance_in_series(found, reception, noise)
    used = stacked_rows(model, found._replace(variance=series), ranges, own, said)
    opened_up = covariance + torch.diag_embed(variance)
    new = update(opened_up, used.observation, used.variance, used.innovation)
    belief = fed_back(model, prior, new.correction, ranges.anew.shift, block)
    belief = with_covariance(belief, new.covariance[..., : model.size, : model.size])
    belief = belief._replace(
        vehicle=belief.vehicle._replace(refused=said.refused),
        refused=places.spread_counts(ranges.refused, prior.refused),
    )
    there = found.present > 0.5
    spread = (found.observation @ covariance * found.observation).sum(-1) + found.variance
    shown = vehicle.rows.spread(own.present) > 0.5
    return TightEnded(
        prior,
        belief,
        torch.where(shown, own.innovation, torch.nan),
        said,
        torch.where(there, found.innovation, torch.nan),
        torch.where(there, spread, torch.nan),
        ranges,
    )


def own_judged(
    model: TightModel,
    own: Measured,
    covariance: Tensor,
    prior: TightBelief[Any],
    ranges: RangesJudged,
) -> Judged:
    """Return what is believed of what the vehicle measures of itself.

    A vehicle whose kinds wait for an anchor finds it in as many ranges as tell a position: while
    those are believed nothing resets for itself, and where position begins anew by them, only the
    anchor's company is listened to.

    Args:
        model: The filter.
        own: What the vehicle measures, shape (...).
        covariance: P, of which H takes as many states as it has columns.
        prior: Prediction, batch shape (...).
        ranges: What is believed of the ranges.

    Returns:
        Verdicts per kind.
    """
    vehicle, w = model.vehicle, own.observation.shape[-1]
    _, spread = projected(covariance[..., :w, :w], own.observation)
    nis = nis_by_kind(vehicle, own, own.innovation, spread)
    faults = position_faults(vehicle.gate, vehicle.rows, own)
    refused = prior.vehicle.refused
    if vehicle.anchor is None:
        return judged(vehicle, nis, own.present, refused, faults=faults)
    vouched, unheard = vouching(model, own, ranges)
    held = torch.where(
        vouched.unsqueeze(-1), refused.clamp(max=vehicle.gate.reset_after - 1), refused
    )
    said = judged(vehicle, nis, own.present, held, faults=faults)
    return Judged(
        said.nis,
        torch.where(unheard, int(Verdict.REFUSED_BY_GATE), said.verdict),
        torch.where(unheard, held, said.refused),
        said.weight,
    )


def vouching(model: TightModel, own: Measured, ranges: RangesJudged) -> tuple[Tensor, Tensor]:
    """Return where ranges vouch for a vehicle that waits for an anchor, and what is unheard.

    Args:
        model: The filter; its vehicle has an anchor.
        own: What the vehicle measures, shape (...).
        ranges: What is believed of the ranges.

    Returns:
        Whether as many ranges are believed as tell a position, bool, shape (...), and which kinds
        are not listened to because position begins anew, bool, shape (..., kinds).
    """
    vehicle = model.vehicle
    fine = believed(ranges.verdict[..., : ranges.verdict.shape[-1] // 2])
    company = torch.zeros_like(own.present, dtype=torch.bool)
    for kind in (vehicle.anchor, *vehicle.company):
        if kind is not None:
            company[..., kind] = True
    told = own.present[..., vehicle.anchor or 0] > 0.5
    vouched = (fine.sum(-1) >= model.options.gate.least_satellites) & ~told
    return vouched, ranges.reset[..., :1] & (own.present > 0.5) & ~company


def stacked_rows(
    model: TightModel, found: Measured, ranges: RangesJudged, own: Measured, said: Judged
) -> Measured:
    """Return what is believed, the vehicle's own rows first, against the clock as it was set.

    Args:
        model: The filter.
        found: What ranges say, with the variances with which they count.
        ranges: What is believed of it.
        own: What the vehicle measures of itself.
        said: What is believed of that.

    Returns:
        Rows in error states and surprises; refused ones are blank.
    """
    heard = taken(model.vehicle, own, said.verdict, said.weight)
    further = found.observation.shape[-1] - heard.observation.shape[-1]
    keep = believed(ranges.verdict)
    left = found.innovation - told_by_clock(model, found, ranges.anew.shift)
    H = torch.where(keep.unsqueeze(-1), found.observation, 0.0)
    own_rows = torch.nn.functional.pad(heard.observation, (0, further))
    return Measured(
        torch.cat((heard.innovation, torch.where(keep, left, 0.0)), -1),
        torch.cat((own_rows, H), -2),
        torch.cat((heard.variance, torch.where(keep, found.variance, 1.0)), -1),
        torch.cat((own.present, found.present), -1),
    )


def fed_back(
    model: TightModel, belief: TightBelief[Any], correction: Tensor, shift: Tensor, block: Any
) -> TightBelief[Any]:
    """Return a belief moved by a correction; its covariance stays.

    Args:
        model: The filter.
        belief: Belief at a block's end, batch shape (...).
        correction: In the order of the error state, surprises may follow, shape (..., n + c + …).
        shift: By how much the clock was set, shape (..., c).
        block: The vehicle's side of the block.

    Returns:
        Belief.
    """
    n = model.first_clock
    moved = model.vehicle.moved(belief.vehicle, correction[..., :n], block)
    return belief._replace(
        vehicle=moved, clock=belief.clock + shift + correction[..., n : model.size]
    )


def with_covariance(belief: TightBelief[Any], covariance: Tensor) -> TightBelief[Any]:
    """Return a belief with another covariance, its vehicle's block with it.

    Args:
        belief: Belief, batch shape (...).
        covariance: Of the whole error, shape (..., n + c, n + c).
    """
    n = belief.vehicle.covariance.shape[-1]
    vehicle = belief.vehicle._replace(covariance=covariance[..., :n, :n])
    return belief._replace(vehicle=vehicle, covariance=covariance)
