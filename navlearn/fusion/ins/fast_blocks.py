"""All blocks of drives linearised at a guess of the beliefs with which they start."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.fusion.ins.composed import preintegrated
from navlearn.fusion.ins.layout import belief_difference, state_difference
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.ins.noise import InsNoise, walks
from navlearn.mechanization.preintegration import Preintegrated, block_transition, predict
from navlearn.states import ImuSample


class Sums(NamedTuple):
    """What the samples of all blocks say, whatever states the blocks start from.

    Attributes:
        pre: Increments of each block, batch shape (B, K).
        sensor: Sensor parameters that were taken off, shape (B, K, m).
    """

    pre: Preintegrated
    sensor: Tensor


class Ahead(NamedTuple):
    """Blocks predicted from a guess.

    Attributes:
        end: Beliefs at the blocks' ends before any update, batch shape (B, K).
        transition: Φ, shape (B, K, n, n).
        noise: Q, shape (B, K, n, n).
        shift: By how much a block's end moves because the one before ends elsewhere than the
            block was guessed to start, shape (B, K, n); zero for the first.
    """

    end: InsBelief
    transition: Tensor
    noise: Tensor
    shift: Tensor


NEAR = (5.0, 0.1)
"""Largest moves of velocity, m/s, and attitude, rad, in a pass after which increments are summed
up again and the gate's verdicts are taken over; position changes neither."""

LEFT = 1e-6
"""What following new sensor parameters to first order may leave of a block's velocity, m/s."""


class RenewedSums:
    """The sums that passes over the same blocks share, renewed as the passes come near.

    Increments follow new sensor parameters to first order until the passes are near; from there on
    they are summed up again wherever that would change them.
    """

    def __init__(
        self, model: InsFilterModel, start: InsBelief, samples: ImuSample, noise: InsNoise
    ) -> None:
        """Sum up all blocks with the sensor parameters at the start.

        Args:
            model: The filter.
            start: Belief before the first sample, batch shape (B,).
            samples: Samples, coning compensated, shape (B, K, n) each.
            noise: Noise densities.
        """
        self.model, self.samples, self.noise = model, samples, noise
        blocks = samples.dt.shape[:2]
        at_start = start.sensor.unsqueeze(1).expand(*blocks, start.sensor.shape[-1])
        with torch.no_grad():
            self.sums = summed(model, at_start, samples, noise)
        self.near = self.settled = False
        self.with_gradient: Sums | None = None

    def ahead(self, guess: InsBelief) -> Ahead:
        """Return all blocks predicted from a guess of the beliefs at their starts.

        Args:
            guess: Batch shape (B, K).
        """
        return predicted(self.model, guess, self._for(guess), self.noise)

    def came_near(self, new: InsBelief, old: InsBelief) -> bool:
        """Return whether a pass came near: its linearisation and sensor parameters will do.

        Args:
            new: Beliefs at which blocks start, batch shape (B, K).
            old: The same before.
        """
        moved = state_difference(new.state, old.state).abs()
        speed, turn = float(moved[..., 3:6].amax()), float(moved[..., 6:].amax())
        near = speed < NEAR[0] and turn < NEAR[1]
        self.near = self.near or near
        return near

    def _for(self, guess: InsBelief) -> Sums:
        if torch.is_grad_enabled():
            if self.with_gradient is None:
                self.with_gradient = summed(self.model, guess.sensor, self.samples, self.noise)
            return self.with_gradient
        self.with_gradient = None
        if self.near:
            # again and again: renewed verdicts may move the sensor parameters far
            if left_by_first_order(self.sums, guess.sensor) > LEFT:
                self.sums = summed(self.model, guess.sensor, self.samples, self.noise)
            self.settled = True
        return self.sums


def summed(model: InsFilterModel, sensor: Tensor, samples: ImuSample, noise: InsNoise) -> Sums:
    """Return what the samples of all blocks say.

    Args:
        model: The filter.
        sensor: Sensor parameters to take off, shape (B, K, m).
        samples: Samples, coning compensated, shape (B, K, n) each.
        noise: Noise densities.

    Returns:
        Sums.
    """
    held = sensor.detach()
    return Sums(preintegrated(model, held, samples, noise), held)


def left_by_first_order(sums: Sums, sensor: Tensor) -> float:
    """Return what is wrong with the velocity of the worst block, m/s, to second order.

    Args:
        sums: Sums with other sensor parameters taken off.
        sensor: Sensor parameters that increments are to follow, shape (B, K, m).
    """
    known = sums.pre.by_sensor.shape[-1]
    change = (sensor - sums.sensor)[..., :known].unsqueeze(-1)
    moved = (sums.pre.by_sensor @ change).squeeze(-1)
    turn, push = moved[..., 6:].norm(dim=-1), moved[..., 3:6].norm(dim=-1)
    left = turn * (0.5 * turn * sums.pre.velocity.norm(dim=-1) + push)
    return float(left.detach().amax())


def predicted(model: InsFilterModel, begin: InsBelief, sums: Sums, noise: InsNoise) -> Ahead:
    """Predict and linearise all blocks.

    Args:
        model: The filter.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        sums: What their samples say.
        noise: Noise densities.

    Returns:
        The blocks' ends.
    """
    change = begin.sensor - sums.sensor
    state = predict(begin.state, sums.pre, change)
    transition, q = block_transition(begin.state, sums.pre, walks(model.layout, noise), change)
    end = begin._replace(state=state)
    return Ahead(end, transition, q, shift_of_ins_blocks(begin, end, transition))


def shift_of_ins_blocks(begin: InsBelief, end: InsBelief, transition: Tensor) -> Tensor:
    """Return by how much a block's prediction moves because the one before ends elsewhere.

    Args:
        begin: Beliefs at which blocks were linearised, batch shape (B, K).
        end: Beliefs at the blocks' ends as predicted from there, batch shape (B, K).
        transition: Φ of each block, shape (B, K, n, n).

    Returns:
        Shift in the order of the error state, zero for the first block, shape (B, K, n).
    """
    before = map_ins_belief(end, lambda x: x[:, :-1])
    gap = belief_difference(before, map_ins_belief(begin, lambda x: x[:, 1:]))
    gap = torch.nn.functional.pad(gap, (0, 0, 1, 0))
    return (transition @ gap.unsqueeze(-1)).squeeze(-1)
