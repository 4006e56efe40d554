"""The full-IMU filter as a loop over blocks: predict one, update at its end, feed back, go on.

As for the RISS filter, one loop serves the closed and the open form: it carries the point at which
the model is linearised, the estimate's deviation from it, and the covariance. Closed: the deviation
is fed back after every update, so it is zero between updates. Open: the point is the mechanization
running free, and the deviation is minus its estimated error.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.gated_update import gated_update
from navlearn.fusion.gating import Judged
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import moved_belief
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.noise import InsNoise
from navlearn.fusion.ins.path import ins_path_in_blocks
from navlearn.fusion.ins.timeline import InsOccasion, InsTimeline, ins_trajectory
from navlearn.fusion.ins.updates import ins_measured
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.recursion import stacked, unstacked
from navlearn.states import ImuSample, InsState

TILT: Final = 0.05
"""Deviation that a reset adds to tilt, in parts of what it adds to azimuth."""

ANEW: Final = (1000.0, 50.0)
"""Deviations that a reset of position adds to position, m, and velocity, m/s."""


class InsCarried(NamedTuple):
    """What the loop carries from block to block.

    Attributes:
        point: Where the model is linearised, with the covariance, batch shape (B,).
        deviation: Estimate minus point, shape (B, n).
    """

    point: InsBelief
    deviation: Tensor


class InsEnded(NamedTuple):
    """One block's end.

    Attributes:
        prior: Belief before the update.
        belief: Belief after it.
        innovation: Measured minus predicted, shape (B, r).
        judged: What the gate said.
        deviation: Estimate minus free mechanization, shape (B, n); zero in a closed loop.
    """

    prior: InsBelief
    belief: InsBelief
    innovation: Tensor
    judged: Judged
    deviation: Tensor


PredictInsBlock = Callable[
    [InsFilterModel, InsCarried, ImuSample, InsNoise], tuple[InsCarried, InsState | None]
]


def end_ins_block(
    model: InsFilterModel, carried: InsCarried, occasion: InsOccasion, noise: InsNoise
) -> tuple[InsCarried, InsEnded]:
    """Update at the end of a block.

    Args:
        model: The filter.
        carried: Prediction at the block's end.
        occasion: What there is to measure, shape (B,) each.
        noise: Deviations of measurements.

    Returns:
        What is carried on, and the record of this end.
    """
    point, deviation = carried
    prior = point if model.closed else moved_belief(point, deviation)
    found = ins_measured(model, point, occasion, noise)
    if not model.closed:
        told = (found.observation @ deviation.unsqueeze(-1)).squeeze(-1)
        found = found._replace(innovation=found.innovation - told)
    new, verdict = gated_update(
        model, point.covariance, point.refused, found, lambda v: ins_opened(model, v, found)
    )
    point = point._replace(covariance=new.covariance, refused=verdict.refused)
    shown = torch.where(model.rows.spread(found.present) > 0.5, found.innovation, torch.nan)
    if model.closed:
        belief = moved_belief(point, new.correction)
        return InsCarried(belief, deviation), InsEnded(prior, belief, shown, verdict, deviation)
    deviation = deviation + new.correction
    belief = moved_belief(point, deviation)
    return InsCarried(point, deviation), InsEnded(prior, belief, shown, verdict, deviation)


def ins_opened(model: InsFilterModel, verdict: Tensor, found: Measured) -> Tensor:
    """Return the variance added where the gate resets.

    Where position resets, position and velocity begin anew, so unknown that nothing of the fix
    reaches attitude or sensors through them. Azimuth, through which a car drifts, gets
    ``reset_azimuth``, and tilt hardly anything: gyros keep it far longer than a fault lasts, and a
    filter that takes its tilt from faulty fixes never finds back. A velocity that resets for itself
    gets its innovation squared. What the other kinds contradict is shared among the states that
    they observe, in proportion to how much each shows.

    Args:
        model: The filter.
        verdict: Verdict per kind, shape (..., 6).
        found: What is measured, shape (...).

    Returns:
        Diagonal of a covariance, shape (..., n).
    """
    reset = (verdict == int(Verdict.ACCEPTED_BY_RESET)).to(found.innovation)
    square = (found.innovation * found.innovation).detach() * model.rows.spread(reset)
    extra = torch.zeros_like(found.observation[..., 0, :])
    for kind in model.rows.kinds:
        rows = model.rows.of(kind)
        if rows is None:
            continue
        part, H = square[..., rows], found.observation[..., rows, :].detach()
        if kind in (InsKind.POSITION, InsKind.VELOCITY):
            first = 0 if kind == InsKind.POSITION else 3
            after = model.layout.size - first - part.shape[-1]
            extra = extra + torch.nn.functional.pad(part, (first, after))
            anew = _anew(model, extra, everything=kind == InsKind.POSITION)
            extra = extra + anew * anew * reset[..., kind, None]
            continue
        H = H * (H.abs() > 1e-3)
        weight = H * H / (H * H).sum(-1, keepdim=True).clamp(min=1e-12)
        share = weight * part.unsqueeze(-1) / (H * H).clamp(min=1e-6)
        extra = extra + share.sum(-2)
    return extra


def _anew(model: InsFilterModel, like: Tensor, *, everything: bool) -> Tensor:
    """Return the deviations that a reset adds beside the innovation, shape (n,)."""
    turn = model.gate.reset_azimuth * like.new_tensor([TILT, TILT, 1.0])
    position, velocity = (torch.full_like(turn, size * float(everything)) for size in ANEW)
    return torch.cat((position, velocity, turn, like.new_zeros(model.layout.size - 9)))


def run_ins_loop(
    model: InsFilterModel,
    start: InsBelief,
    line: InsTimeline,
    noise: InsNoise,
    predict: PredictInsBlock,
    method: str,
) -> InsHistory:
    """Run the filter block after block.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations.
        predict: How a block is predicted.
        method: Name of that, for the record.

    Returns:
        History.
    """
    samples, occasions = unstacked(line.samples), unstacked(line.occasion)
    carried = InsCarried(start, torch.zeros_like(start.covariance[..., 0]))
    ends: list[InsEnded] = []
    inside: list[InsState] = []
    for block, occasion in zip(samples, occasions, strict=True):
        carried, path = predict(model, carried, block, noise)
        carried, ended = end_ins_block(model, carried, occasion, noise)
        ends.append(ended)
        if path is not None:
            inside.append(path)
    record: InsEnded = stacked(ends)
    path = stacked(inside) if inside else ins_path_in_blocks(model, start, record.belief, line)
    return ins_history(line, record, path, method, 1)


def ins_history(
    line: InsTimeline, record: InsEnded, inside: InsState, method: str, passes: int
) -> InsHistory:
    """Return the history of a run.

    Args:
        line: The drives in blocks.
        record: Every block's end, batch shape (B, K).
        inside: Prediction inside blocks, batch shape (B, K, n).
        method: Form that computed it.
        passes: Passes it took.

    Returns:
        History.
    """
    return InsHistory(
        line.blocks.end,
        line.blocks.fix,
        record.prior,
        record.belief,
        ins_trajectory(line, inside, record.belief.state),
        record.innovation,
        record.judged.nis,
        record.judged.verdict,
        (record.judged.verdict == int(Verdict.ACCEPTED_BY_RESET)).sum(1),
        -record.deviation,
        method,
        passes,
    )
