"""A batch of drives laid out in blocks, with what is measured at the end of each."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.fusion.astray_fixes import astray_at_ends, astray_fixes
from navlearn.fusion.blocks import Blocks, cut, gathered, samples_in_blocks
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.measured import Occasion
from navlearn.fusion.sensor_errors import odometer_acceleration
from navlearn.fusion.standstill import Rest, rest_at_end
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, Trajectory

HARDEST = 15.0
"""Acceleration beyond which the odometer's step is not one of speed, m/s²."""


class Timeline(NamedTuple):
    """Drives in blocks.

    Attributes:
        blocks: Where the blocks are.
        samples: Samples, shape (B, K, n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (B, K, n).
        occasion: What there is to measure at the end of each block, shape (B, K) each.
    """

    blocks: Blocks
    samples: RissSample
    acceleration: Tensor
    occasion: Occasion


def timeline(
    model: FilterModel, samples: RissSample, fixes: GnssFix, timing: FixTiming
) -> Timeline:
    """Return drives laid out in blocks.

    Args:
        model: The filter.
        samples: Samples, shape (B, T) each.
        fixes: Fixes, shape (B, M) each; M may be 0.
        timing: Where they fall, shape (B, M) each.

    Returns:
        Timeline.
    """
    fixes, timing = at_least_one_fix(fixes, timing, samples.dt)
    blocks = cut(samples.dt, timing.index, model.options.max_block)
    laid = samples_in_blocks(samples, blocks)
    if "delay" in model.errors.speed_terms or model.layout.has_velocity:
        acceleration = odometer_acceleration(samples.dt, samples.speed)
        laid_acceleration = gathered(acceleration, blocks.gather)
        last_acceleration = gathered(acceleration, blocks.end)
    else:
        laid_acceleration = torch.zeros_like(laid.dt)
        last_acceleration = odometer_acceleration(samples.dt, samples.speed, blocks.end)
    # no car does that: the odometer dropped out or came back
    last_acceleration = torch.where(last_acceleration.abs() < HARDEST, last_acceleration, 0.0)
    fix, delay = fixes_at_ends(blocks, fixes, timing)
    last = RissSample(*(gathered(channel, blocks.end) for channel in samples))
    occasion = Occasion(
        fix,
        delay,
        BlockEnd(last, last_acceleration),
        rest_at_end(model.errors, laid),
        astray_at_ends(blocks, astray_fixes(model, samples, fixes, timing)),
    )
    return Timeline(blocks, laid, laid_acceleration, occasion)


def trajectory_of_blocks(line: Timeline, inside: Trajectory, after: NavState) -> Trajectory:
    """Return the full-rate trajectory of what happened inside blocks.

    Args:
        line: The timeline.
        inside: Prediction at every place of every block, shape (B, K, n) each.
        after: State after the update at each block's end, shape (B, K) each.

    Returns:
        Trajectory, shape (B, T) each.
    """
    blocks = line.blocks
    flat = Trajectory(*(channel.flatten(1) for channel in inside))
    if not blocks.even:
        flat = Trajectory(*(gathered(channel, blocks.place) for channel in flat))
    corrected = [
        at_ends(blocks, channel, values) for channel, values in zip(flat[:4], after, strict=True)
    ]
    lat, lon, height, azimuth = corrected
    return Trajectory(lat, lon, height, azimuth, flat.v_e, flat.v_n, flat.v_u)


def at_ends(blocks: Blocks, channel: Tensor, values: Tensor) -> Tensor:
    """Return a channel with other values at the ends of blocks.

    Args:
        blocks: Blocks.
        channel: Shape (B, T) or (B, T, d).
        values: Shape (B, K) or (B, K, d).

    Returns:
        Shape of ``channel``.
    """
    # where several blocks end at one sample only the last may receive a gradient
    last = blocks.closes > 0.5
    final = torch.where(last, torch.arange(last.shape[1], device=last.device), last.shape[1])
    final = torch.flip(torch.cummin(torch.flip(final, (1,)), 1).values, (1,))
    end = blocks.end
    if channel.dim() == 3:
        wide = (*end.shape, channel.shape[-1])
        last, end = last.unsqueeze(-1), end.unsqueeze(-1).expand(wide)
    value = torch.where(last, values, gathered(values, final).detach())
    return torch.scatter(channel, 1, end, value)


def fixes_at_ends(blocks: Blocks, fixes: GnssFix, timing: FixTiming) -> tuple[GnssFix, Tensor]:
    """Return the fix at the end of each block, and how old it is.

    Args:
        blocks: Blocks.
        fixes: Fixes, shape (B, M) each; M at least 1.
        timing: Where they fall, shape (B, M) each.

    Returns:
        Fixes (none valid where a block ends without one) and delays, shape (B, K) each.
    """
    chosen = blocks.fix.clamp(min=0)
    there = (blocks.fix >= 0).to(timing.delay)
    fix = GnssFix(*(gathered(channel, chosen) for channel in fixes))
    fix = fix._replace(has_position=fix.has_position * there, has_velocity=fix.has_velocity * there)
    return fix, gathered(timing.delay, chosen) * there


def at_least_one_fix(fixes: GnssFix, timing: FixTiming, dt: Tensor) -> tuple[GnssFix, FixTiming]:
    """Return fixes and timing, one that stands for no fix where there are none.

    Args:
        fixes: Fixes, shape (B, M) each; M may be 0.
        timing: Where they fall, shape (B, M) each.
        dt: Lengths of the intervals, s, shape (B, T).
    """
    if timing.index.shape[-1] > 0:
        return fixes, timing
    none = dt.new_zeros((dt.shape[0], 1))
    absent = GnssFix(*(none for _ in fixes))
    return absent, FixTiming(torch.full_like(none, -1, dtype=torch.int64), none)


def occasion_after(
    model: FilterModel,
    sample: RissSample,
    *,
    fix: GnssFix,
    delay: Tensor | None = None,
    rest: Rest | None = None,
    acceleration: Tensor | None = None,
    astray: Tensor | None = None,
) -> Occasion:
    """Return what there is to measure after one interval, as a car meets it while driving.

    Args:
        model: The filter.
        sample: The interval's sample, shape (...) each.
        fix: The fix, shape (...) each.
        delay: End of the interval minus the fix's time, s, shape (...); None means zero.
        rest: Standstill up to now that has not been used yet; None means none.
        acceleration: Forward acceleration by the odometer, m/s², shape (...); None means a steady
            speed.
        astray: 1.0 where the fix has moved otherwise than the car, shape (...); None for nowhere.

    Returns:
        Occasion.

    Raises:
        ConfigError: If the model needs the acceleration and none is given.
    """
    zero = torch.zeros_like(sample.dt)
    if rest is None:
        regressors = zero.unsqueeze(-1).expand(*zero.shape, len(model.errors.gyro_terms))
        rest = Rest(zero, zero, regressors, zero)
    end = BlockEnd(sample, known_acceleration(model, sample, acceleration))
    return Occasion(fix, zero if delay is None else delay, end, rest, astray)


def known_acceleration(
    model: FilterModel, sample: RissSample, acceleration: Tensor | None
) -> Tensor:
    """Return the forward acceleration of one interval, zero where a model does without.

    Args:
        model: The filter.
        sample: The sample, shape (...) each.
        acceleration: As given, m/s², shape (...), or None.

    Raises:
        ConfigError: If the model needs it and none is given.
    """
    if acceleration is not None:
        return acceleration
    if model.layout.has_velocity or "delay" in model.errors.speed_terms:
        raise ConfigError(
            f"filter: model {model.options.model} with speed terms {model.options.speed_states} "
            "needs the forward acceleration; pass acceleration="
        )
    return torch.zeros_like(sample.dt)
