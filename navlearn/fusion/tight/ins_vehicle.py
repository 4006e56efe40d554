"""A full IMU under a tightly coupled filter: a strapdown carries the antenna."""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from navlearn.filters.ins_belief import InsBelief
from navlearn.frames import shift_geodetic
from navlearn.fusion.ins.antenna import ins_antenna_offset, ins_antenna_velocity
from navlearn.fusion.ins.composed import ahead_of, end_of, has_closed_form
from navlearn.fusion.ins.layout import belief_difference, moved_belief, state_difference
from navlearn.fusion.ins.model import InsFilterModel, ins_filter_model
from navlearn.fusion.ins.moment import moment_of
from navlearn.fusion.ins.noise import InsNoise, ins_noise_from_log, log_ins_noise
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.path import ins_path_in_blocks
from navlearn.fusion.ins.recursion import ins_opened
from navlearn.fusion.ins.sequential import carried_ins_sample, predict_ins_sample
from navlearn.fusion.ins.timeline import (
    InsOccasion,
    InsTimeline,
    ins_timeline,
    ins_trajectory,
)
from navlearn.fusion.ins.updates import ins_measured
from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.gated_vehicle import GatedVehicle, closed_only
from navlearn.fusion.tight.passes import InsPasses
from navlearn.fusion.tight.trees import block_at, for_points
from navlearn.fusion.tight.vehicle import Antenna, VehicleAhead, VehicleLine, no_fixes
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


class InsBlock(NamedTuple):
    """Blocks of a full-IMU drive, batch shape (B,) or (B, K).

    Attributes:
        samples: Samples, coning compensated, shape (..., n) each, vectors (..., n, 3).
        occasion: What there is to measure at the end, shape (...) each.
    """

    samples: ImuSample
    occasion: InsOccasion


class InsVehicle(GatedVehicle):
    """A car with three gyros and three accelerometers; answers ``Vehicle``.

    ``log_noise`` is as in :class:`navlearn.fusion.ins.loosely_coupled.InsEkf`.
    """

    model: InsFilterModel

    def __init__(self, options: InsEkfOptions | None = None) -> None:
        """Make the options ready.

        Args:
            options: Choices; None means the defaults. Feedback must be closed.

        Raises:
            ConfigError: If feedback is open.
        """
        super().__init__()
        self.options = options or InsEkfOptions()
        closed_only(self.options.feedback)
        self.model = ins_filter_model(self.options)
        self.log_noise = nn.Parameter(log_ins_noise(self.options.noise), requires_grad=False)

    @property
    def noise(self) -> InsNoise:
        """Noise densities and deviations as they stand."""
        return ins_noise_from_log(self.log_noise)

    def laid_out(self, samples: ImuSample, fixes: GnssFix | None, timing: FixTiming) -> VehicleLine:
        """Return drives in blocks that end where ranges are received; see ``Vehicle``."""
        given = no_fixes(timing) if fixes is None else fixes
        line = ins_timeline(self.model, samples, given, timing)
        return ins_vehicle_line(line)

    def all_blocks(self, line: VehicleLine) -> InsBlock:
        """Return all blocks, batch shape (B, K)."""
        whole: InsTimeline = line.line
        return InsBlock(whole.samples, whole.occasion)

    def block(self, line: VehicleLine, k: int) -> InsBlock:
        """Return one block, batch shape (B,)."""
        return block_at(self.all_blocks(line), k)

    def predicted(self, belief: InsBelief, block: InsBlock) -> VehicleAhead:
        """Return the prediction over blocks from the beliefs at their starts."""
        return VehicleAhead(*ahead_of(self.model, belief, block.samples, self.noise))

    def predicted_in_turn(self, belief: InsBelief, block: InsBlock) -> VehicleAhead:
        """Return the same sample by sample, as the textbook has it."""
        nothing = torch.zeros_like(belief.covariance)
        at = belief._replace(covariance=nothing)
        eye = torch.eye(nothing.shape[-1], dtype=nothing.dtype, device=nothing.device)
        whole, along = eye.expand(nothing.shape), belief.state.lat.dim()
        for channels in zip(*(x.unbind(along) for x in block.samples), strict=True):
            at, transition = predict_ins_sample(self.model, at, ImuSample(*channels), self.noise)
            whole = transition @ whole
        return VehicleAhead(at._replace(covariance=belief.covariance), whole, at.covariance)

    def carried(self, belief: InsBelief, block: InsBlock) -> InsBelief:
        """Return beliefs moved over blocks, their covariance as it was; see ``Vehicle``."""
        return end_of(self.model, belief, block.samples, self.noise)[0]

    def carried_in_turn(self, belief: InsBelief, block: InsBlock) -> InsBelief:
        """Return the same sample by sample: the oracle of :meth:`carried`."""
        along = belief.state.lat.dim()
        for channels in zip(*(x.unbind(along) for x in block.samples), strict=True):
            belief = carried_ins_sample(self.model, belief, ImuSample(*channels))
        return belief

    def carried_apart(self, belief: InsBelief, deviation: Tensor, block: InsBlock) -> Tensor:
        """Return how far from the first point others are at the ends of blocks; see ``Vehicle``.

        Positions by the ways that the points go, which keep the digits that narrow points need;
        how the axes of a start elsewhere are turned (20 m go other 3 µm for a start 1 m elsewhere)
        is left out.
        """
        batch, points = deviation.dim() - 2, deviation.shape[-2]
        wide = for_points(block.samples, batch, points)
        start = moved_belief(for_points(belief, batch, points), deviation)
        end, way = end_of(self.model, start, wide, self.noise)
        return apart_from_first(deviation, end.state, way, end.sensor)

    def moved_at_start(self, belief: InsBelief, correction: Tensor, block: InsBlock) -> InsBelief:  # noqa: ARG002
        """Return beliefs at the starts of blocks moved by a correction; see ``Vehicle``."""
        return moved_belief(belief, correction)

    def in_samples(self, block: InsBlock) -> list[InsBlock]:
        """Return the samples of blocks as blocks of one sample each."""
        along = block.samples.dt.dim() - 1
        channels = (x.unsqueeze(along + 1).unbind(along) for x in block.samples)
        return [InsBlock(ImuSample(*one), block.occasion) for one in zip(*channels, strict=True)]

    def measured(self, belief: InsBelief, block: InsBlock) -> Measured:
        """Return what the vehicle measures of itself at the ends of blocks."""
        return ins_measured(self.model, belief, block.occasion, self.noise)

    def antenna(self, belief: InsBelief, block: InsBlock, delay: Tensor) -> Antenna:
        """Return where the antenna was ``delay`` seconds before the ends of blocks."""
        now = moment_of(self.model, belief, block.occasion.last)
        there = ins_antenna_offset(self.model, belief, now, delay)
        moving = ins_antenna_velocity(self.model, belief, now, delay)
        lat, lon, height = shift_geodetic(*belief.state[:3], *there.value.unbind(-1))
        variance = torch.zeros_like(moving.value)
        return Antenna(lat, lon, height, moving.value, there.by_error, moving.by_error, variance)

    def moved(self, belief: InsBelief, correction: Tensor, block: InsBlock) -> InsBelief:  # noqa: ARG002
        """Return a belief moved by a correction; its covariance stays."""
        return moved_belief(belief, correction)

    def difference(self, belief: InsBelief, other: InsBelief, block: InsBlock) -> Tensor:  # noqa: ARG002
        """Return minus the correction by which ``moved`` leads from ``belief`` to ``other``."""
        return belief_difference(belief, other)

    def opened(self, verdict: Tensor, found: Measured, innovation: Tensor) -> Tensor:
        """Return the variance added where the gate resets one of its own kinds."""
        return ins_opened(self.model, verdict, found._replace(innovation=innovation))

    def passes(self, start: InsBelief, line: VehicleLine) -> InsPasses | None:
        """Return the passes of the fast form; None for models that preintegration does not tell."""
        if not has_closed_form(self.model):
            return None
        return InsPasses(self.model, start, line.line, self.noise)

    def path(self, start: InsBelief, after: InsBelief, line: VehicleLine) -> InsState:
        """Return the causal solution at full rate, batch shape (B, T)."""
        inside = ins_path_in_blocks(self.model, start, after, line.line)
        return ins_trajectory(line.line, inside, after.state)


def ins_vehicle_line(line: InsTimeline) -> VehicleLine:
    """Return a timeline as vehicles have it.

    Args:
        line: The drives in blocks.
    """
    return VehicleLine(line.blocks, line, line.occasion.delay)


def apart_from_first(deviation: Tensor, end: InsState, way: Tensor, sensor: Tensor) -> Tensor:
    """Return how far from the first point others end, positions by the ways they go.

    Args:
        deviation: Points at the start in the order of the error state, shape (..., P, n).
        end: States at the end, batch shape (..., P).
        way: Ways there, east, north, up, m, shape (..., P, 3).
        sensor: Sensor parameters at the end, shape (..., P, m).

    Returns:
        Shape (..., P, n).
    """
    along = deviation.dim() - 2
    centre = InsState(*(x.narrow(along, 0, 1).expand_as(x) for x in end))
    apart = state_difference(end, centre)
    position = deviation[..., :3] + way - way[..., :1, :]
    turn = _unwound(apart[..., 6:], deviation[..., 6:9])
    return torch.cat((position, apart[..., 3:6], turn, sensor - sensor[..., :1, :]), -1)


def _unwound(turn: Tensor, near: Tensor) -> Tensor:
    """Return the same turns by whole turns more, as near to others as may be, shape (..., 3).

    Points may lie further than half a turn apart, and attitudes tell the shorter way round only.
    """
    square = (turn * turn).sum(-1, keepdim=True)
    angle = torch.where(square > 0.0, square, 1.0).sqrt()
    along = (turn * near).sum(-1, keepdim=True) / angle
    more = torch.round((along - angle).detach() / (2.0 * math.pi))
    more = torch.where(square > 0.0, more, 0.0)
    return turn * (1.0 + 2.0 * math.pi * more / angle)
