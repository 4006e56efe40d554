"""A batch of full-IMU drives laid out in blocks, with what is measured at the end of each."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from navlearn.fusion.astray_fixes import astray_at_ends
from navlearn.fusion.blocks import Blocks, cut, gathered, samples_in_blocks
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.motion_check import astray
from navlearn.fusion.seen_fixes import Carriage
from navlearn.fusion.standstill import stationary_tail
from navlearn.fusion.timeline import at_ends, at_least_one_fix, fixes_at_ends
from navlearn.mechanization.coning import coning_sculling, coning_sculling_step
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


class InsRest(NamedTuple):
    """Standstill at the end of blocks, shape (...) each.

    Attributes:
        duration: How long the car has stood still at the block's end, within the block, s.
        omega_ib_b: Mean of the measured angular rate meanwhile, rad/s, shape (..., 3).
        standing: How long the car has stood still, earlier blocks included, s.
    """

    duration: Tensor
    omega_ib_b: Tensor
    standing: Tensor


class InsOccasion(NamedTuple):
    """What there is to measure at the end of a block, shape (...) each.

    Attributes:
        fix: GNSS solution; ``has_position`` and ``has_velocity`` are 0 where none is.
        delay: End of the block minus the fix's time, s.
        last: Last sample of the block.
        rest: Standstill at the block's end.
        aided: 1.0 where odometer and axle may be used, 0.0 where they were used just before.
        astray: 1.0 where the fix has moved otherwise than the car
            (:mod:`navlearn.fusion.motion_check`); None for nowhere.
    """

    fix: GnssFix
    delay: Tensor
    last: ImuSample
    rest: InsRest
    aided: Tensor
    astray: Tensor | None = None


class InsTimeline(NamedTuple):
    """Drives in blocks.

    Attributes:
        blocks: Where the blocks are.
        samples: Samples, coning and sculling compensated, shape (B, K, n) each, vectors
            (B, K, n, 3).
        occasion: What there is to measure at the end of each block, shape (B, K) each.
    """

    blocks: Blocks
    samples: ImuSample
    occasion: InsOccasion


def ins_timeline(
    model: InsFilterModel, samples: ImuSample, fixes: GnssFix, timing: FixTiming
) -> InsTimeline:
    """Return drives laid out in blocks.

    Args:
        model: The filter.
        samples: Samples, shape (B, T) each, vectors (B, T, 3).
        fixes: Fixes, shape (B, M) each; M may be 0.
        timing: Where they fall, shape (B, M) each.

    Returns:
        Timeline.
    """
    fixes, timing = at_least_one_fix(fixes, timing, samples.dt)
    blocks = cut(samples.dt, timing.index, model.options.max_block)
    laid = samples_in_blocks(coning_compensated(samples), blocks)
    fix, delay = fixes_at_ends(blocks, fixes, timing)
    last = ImuSample(*(gathered(channel, blocks.end) for channel in samples))
    aided = _spaced(laid.dt.sum(-1), model.options.aiding_interval)
    wild = astray_at_ends(blocks, astray_ins_fixes(model, samples, fixes, timing))
    rest = ins_rest_at_end(laid)
    return InsTimeline(blocks, laid, InsOccasion(fix, delay, last, rest, aided, wild))


def astray_ins_fixes(
    model: InsFilterModel, samples: ImuSample, fixes: GnssFix, timing: FixTiming
) -> Tensor:
    """Return which fixes have moved otherwise than the car.

    Args:
        model: The filter.
        samples: Samples, shape (B, T) each, vectors (B, T, 3).
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Returns:
        1.0 where one has, shape (B, M).
    """
    return astray(model.gate, arm_from_axle(model), ins_carriage(samples), fixes, timing)


def arm_from_axle(model: InsFilterModel) -> tuple[float, float]:
    """Return the antenna from the rear axle, whose speed the odometer tells, right, forward, m."""
    antenna, axle = model.options.lever_arm, model.options.wheel_lever_arm
    return antenna[0] - axle[0], antenna[1] - axle[1]


def ins_carriage(samples: ImuSample) -> Carriage:
    """Return how samples carry a car on a level road.

    Args:
        samples: Samples, shape (...) each, vectors (..., 3).
    """
    speed, told = samples.speed, samples.has_speed
    return Carriage(samples.dt, -samples.omega_ib_b[..., 2], speed * told, told)


def coning_compensated(samples: ImuSample) -> ImuSample:
    """Return samples whose rates and forces, held through each interval, move a body rightly.

    What :func:`navlearn.mechanization.coning.coning_sculling` adds to increments is spread over
    their intervals; that biases of the sensors change it is of third order.

    Args:
        samples: Samples, shape (..., T) each, vectors (..., T, 3).

    Returns:
        Samples of the same shape.
    """
    omega, force, dt = samples.omega_ib_b, samples.f_b, samples.dt
    wide = dt.unsqueeze(-1)
    per_second = torch.where(wide > 0.0, 1.0 / torch.where(wide > 0.0, wide, 1.0), 0.0)
    rotation, velocity = coning_sculling(omega, force, dt)
    plain, pushed = coning_sculling_step(omega, force, dt)
    return samples._replace(
        omega_ib_b=omega + per_second * (rotation - plain),
        f_b=force + per_second * (velocity - pushed),
    )


def ins_rest_at_end(samples: ImuSample) -> InsRest:
    """Return what the gyros measured over the stationary tail of blocks.

    Args:
        samples: Samples of consecutive blocks, shape (..., K, n) each; dt = 0 pads.

    Returns:
        Standstill, batch shape (..., K); zero where the car moves at the block's end.
    """
    weight, duration, standing = stationary_tail(samples.dt, samples.stationary)
    mean = (weight.unsqueeze(-1) * samples.omega_ib_b).sum(-2)
    return InsRest(duration, mean / duration.clamp(min=1e-9).unsqueeze(-1), standing)


def _spaced(length: Tensor, interval: float) -> Tensor:
    """Return 1.0 at the ends of blocks that lie an interval after the last such end.

    Args:
        length: Lengths of blocks, s, shape (B, K).
        interval: Shortest time between two, s.
    """
    lengths = length.detach().cpu().numpy()
    found = np.zeros(lengths.shape)
    for row, chosen in zip(lengths, found, strict=True):
        since = 0.0
        for k, own in enumerate(row):
            since += own
            # a tenth of slack: blocks that share a gap evenly may be a little short
            if own > 0.0 and since >= 0.9 * interval:
                chosen[k], since = 1.0, 0.0
    return torch.from_numpy(found).to(length)


def ins_trajectory(line: InsTimeline, inside: InsState, after: InsState) -> InsState:
    """Return the full-rate trajectory of what happened inside blocks.

    Args:
        line: The timeline.
        inside: Prediction at every place of every block, batch shape (B, K, n).
        after: State after the update at each block's end, batch shape (B, K).

    Returns:
        Trajectory, batch shape (B, T).
    """
    blocks = line.blocks
    flat = InsState(*(channel.flatten(1, 2) for channel in inside))
    if not blocks.even:
        flat = InsState(*(gathered(channel, blocks.place) for channel in flat))
    return InsState(
        *(at_ends(blocks, channel, values) for channel, values in zip(flat, after, strict=True))
    )


def ins_occasion_after(
    sample: ImuSample,
    *,
    fix: GnssFix,
    delay: Tensor | None = None,
    rest: InsRest | None = None,
    aided: Tensor | None = None,
    astray: Tensor | None = None,
) -> InsOccasion:
    """Return what there is to measure after one interval, as a car meets it while driving.

    Args:
        sample: The interval's sample, shape (...) each.
        fix: The fix, shape (...) each.
        delay: End of the interval minus the fix's time, s, shape (...); None means zero.
        rest: Standstill up to now that has not been used yet; None means none.
        aided: 1.0 where odometer and axle shall be used, shape (...); None means nowhere.
        astray: 1.0 where the fix has moved otherwise than the car, shape (...); None for nowhere.

    Returns:
        Occasion.
    """
    zero = torch.zeros_like(sample.dt)
    if rest is None:
        rest = InsRest(zero, torch.zeros_like(sample.omega_ib_b), zero)
    late, listening = zero if delay is None else delay, zero if aided is None else aided
    return InsOccasion(fix, late, sample, rest, listening, astray)
