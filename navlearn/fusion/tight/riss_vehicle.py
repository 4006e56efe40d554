"""RISS under a tightly coupled filter: odometer and gyro carry the antenna."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from navlearn.filters.belief import Belief
from navlearn.frames import shift_geodetic
from navlearn.fusion.antenna import antenna_offset, antenna_velocity
from navlearn.fusion.filter_model import (
    FilterModel,
    carried_blocks,
    difference,
    fed_back,
    filter_model,
    predict_blocks,
    velocity_by_turn,
)
from navlearn.fusion.ground_velocity import BlockEnd
from navlearn.fusion.measured import Measured, Occasion
from navlearn.fusion.measurements import Kind
from navlearn.fusion.noise import EkfNoise, height_density, log_noise, noise_from_log
from navlearn.fusion.opening import opened
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.record import path_in_blocks
from navlearn.fusion.sequential import carried_sample, predict_sample
from navlearn.fusion.tight.gated_vehicle import GatedVehicle, closed_only
from navlearn.fusion.tight.passes import RissPasses
from navlearn.fusion.tight.trees import block_at, for_points
from navlearn.fusion.tight.vehicle import Antenna, VehicleAhead, VehicleLine, no_fixes
from navlearn.fusion.timeline import Timeline, timeline, trajectory_of_blocks
from navlearn.fusion.updates import car_at_end, measured
from navlearn.states import FixTiming, GnssFix, RissSample, Trajectory


class RissBlock(NamedTuple):
    """Blocks of a RISS drive, batch shape (B,) or (B, K).

    Attributes:
        samples: Samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).
        occasion: What there is to measure at the end, shape (...) each.
        begin: Last sample before the block, its own first where there is none, shape (...) each.
    """

    samples: RissSample
    acceleration: Tensor
    occasion: Occasion
    begin: BlockEnd


class RissVehicle(GatedVehicle):
    """A car with one gyro and an odometer, in 2D or 3D; answers ``Vehicle``.

    ``log_noise`` is as in :class:`navlearn.fusion.loosely_coupled.LooselyCoupledEkf`.
    """

    model: FilterModel

    def __init__(self, options: EkfOptions | None = None) -> None:
        """Make the options ready.

        Args:
            options: Choices; None means the defaults. Feedback must be closed.

        Raises:
            ConfigError: If feedback is open.
        """
        super().__init__()
        self.options = options or EkfOptions()
        closed_only(self.options.feedback)
        self.model = filter_model(self.options)
        self.log_noise = nn.Parameter(log_noise(self.options.noise), requires_grad=False)

    @property
    def noise(self) -> EkfNoise:
        """Noise densities and deviations as they stand."""
        return noise_from_log(self.log_noise)

    def laid_out(
        self, samples: RissSample, fixes: GnssFix | None, timing: FixTiming
    ) -> VehicleLine:
        """Return drives in blocks that end where ranges are received; see ``Vehicle``."""
        given = no_fixes(timing) if fixes is None else fixes
        return vehicle_line(timeline(self.model, samples, given, timing))

    def all_blocks(self, line: VehicleLine) -> RissBlock:
        """Return all blocks, batch shape (B, K)."""
        whole: Timeline = line.line
        first = RissSample(*(channel[:, 0, 0] for channel in whole.samples))
        end = whole.occasion.end
        begin = _before_each(BlockEnd(first, whole.acceleration[:, 0, 0]), end)
        return RissBlock(whole.samples, whole.acceleration, whole.occasion, begin)

    def block(self, line: VehicleLine, k: int) -> RissBlock:
        """Return one block, batch shape (B,)."""
        return block_at(self.all_blocks(line), k)

    def predicted(self, belief: Belief, block: RissBlock) -> VehicleAhead:
        """Return the prediction over blocks from the beliefs at their starts."""
        ahead = predict_blocks(self.model, belief, block.samples, block.acceleration, self.noise)
        end = belief._replace(
            state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
        )
        return VehicleAhead(end, ahead.linearised.transition, ahead.linearised.noise)

    def predicted_in_turn(self, belief: Belief, block: RissBlock) -> VehicleAhead:
        """Return the same sample by sample, as the textbook has it."""
        nothing = torch.zeros_like(belief.covariance)
        at = belief._replace(covariance=nothing)
        eye = torch.eye(nothing.shape[-1], dtype=nothing.dtype, device=nothing.device)
        whole = eye.expand(nothing.shape)
        pushes = block.acceleration.unbind(-1)
        for k, channels in enumerate(zip(*(x.unbind(-1) for x in block.samples), strict=True)):
            sample = RissSample(*channels)
            at, transition, _ = predict_sample(self.model, at, sample, pushes[k], self.noise)
            whole = transition @ whole
        return VehicleAhead(at._replace(covariance=belief.covariance), whole, at.covariance)

    def carried(self, belief: Belief, block: RissBlock) -> Belief:
        """Return beliefs moved over blocks, their covariance as it was; see ``Vehicle``."""
        ahead = carried_blocks(self.model, belief, block.samples, block.acceleration)
        return belief._replace(
            state=ahead.state, sensor=ahead.sensor, velocity_offset=ahead.velocity_offset
        )

    def carried_in_turn(self, belief: Belief, block: RissBlock) -> Belief:
        """Return the same sample by sample: the oracle of :meth:`carried`."""
        pushes = block.acceleration.unbind(-1)
        for k, channels in enumerate(zip(*(x.unbind(-1) for x in block.samples), strict=True)):
            belief = carried_sample(self.model, belief, RissSample(*channels), pushes[k])[0]
        return belief

    def carried_apart(self, belief: Belief, deviation: Tensor, block: RissBlock) -> Tensor:
        """Return how far from the first point others are at the ends of blocks; see ``Vehicle``.

        By the ways that the points go, in metres: differences of latitudes would keep a nanometre,
        of which narrow points make centimetres. What a start elsewhere changes of a way (20 m go
        other 3 µm for a start 1 m elsewhere) is left out, as in the filter's transition.
        """
        batch, points = deviation.dim() - 2, deviation.shape[-2]
        wide = for_points(block, batch, points)
        start = self.moved_at_start(for_points(belief, batch, points), deviation, wide)
        ahead = carried_blocks(self.model, start, wide.samples, wide.acceleration)
        at = self.model.layout.azimuth
        turned = (ahead.state.azimuth - start.state.azimuth).unsqueeze(-1)
        turn = deviation[..., at : at + 1] + _from_first(turned)
        parts = [deviation[..., :3] + _from_first(ahead.way), turn, _from_first(ahead.sensor)]
        if self.model.layout.has_velocity:
            centre = start._replace(state=ahead.state, sensor=ahead.sensor)
            across = velocity_by_turn(self.model, centre, wide.occasion.end)[..., :1, :]
            parts.insert(1, _from_first(ahead.velocity_offset) + across * turn)
        return torch.cat(parts, -1)

    def moved_at_start(self, belief: Belief, correction: Tensor, block: RissBlock) -> Belief:
        """Return beliefs at the starts of blocks moved by a correction; see ``Vehicle``."""
        return fed_back(self.model, belief, correction, block.begin)

    def measured(self, belief: Belief, block: RissBlock) -> Measured:
        """Return what the vehicle measures of itself at the ends of blocks."""
        return measured(self.model.measurement, belief, block.occasion, self.noise)

    def antenna(self, belief: Belief, block: RissBlock, delay: Tensor) -> Antenna:
        """Return where the antenna was ``delay`` seconds before the ends of blocks.

        Its velocity is that of odometer and azimuth (and the offset that is a state of the Shen
        models), so it is as noisy as they are; where the mechanization does not climb, a hill comes
        as a surprise.
        """
        model, end, noise = self.model, block.occasion.end, self.noise
        car = car_at_end(model.measurement, belief, end)
        there, moving = antenna_offset(car, delay), antenna_velocity(car, delay)
        lat, lon, height = shift_geodetic(*belief.state[:3], *there.value.unbind(-1))
        # the mean over a second of what the filter takes to move a driving car upwards
        climb = height_density(model.errors, noise) * (1.0 - end.sample.stationary)
        variance = noise.speed_noise**2 + torch.nn.functional.pad(climb.unsqueeze(-1), (2, 0))
        return Antenna(lat, lon, height, moving.value, there.by_error, moving.by_error, variance)

    def in_samples(self, block: RissBlock) -> list[RissBlock]:
        """Return the samples of blocks as blocks of one sample each."""
        found, begin = list[RissBlock](), block.begin
        pushes = block.acceleration.unsqueeze(-1).unbind(-2)
        for push, *channels in zip(
            pushes, *(x.unsqueeze(-1).unbind(-2) for x in block.samples), strict=True
        ):
            samples = RissSample(*channels)
            end = BlockEnd(RissSample(*(x[..., 0] for x in samples)), push[..., 0])
            found.append(RissBlock(samples, push, block.occasion._replace(end=end), begin))
            begin = end
        return found

    @property
    def angle_rows(self) -> tuple[int, ...]:
        """Rows that are angles: the course."""
        rows = self.rows.of(Kind.COURSE)
        return () if rows is None else tuple(range(rows.start, rows.stop))

    def moved(self, belief: Belief, correction: Tensor, block: RissBlock) -> Belief:
        """Return a belief moved by a correction; its covariance stays."""
        return fed_back(self.model, belief, correction, block.occasion.end)

    def difference(self, belief: Belief, other: Belief, block: RissBlock) -> Tensor:
        """Return minus the correction by which ``moved`` leads from ``belief`` to ``other``."""
        return difference(self.model, belief, other, block.occasion.end)

    def opened(self, verdict: Tensor, found: Measured, innovation: Tensor) -> Tensor:
        """Return the variance added where the gate resets one of its own kinds."""
        return opened(self.model, verdict, found, innovation)

    def passes(self, start: Belief, line: VehicleLine) -> RissPasses:
        """Return the passes of the fast form over drives."""
        return RissPasses(self.model, start, line.line, self.noise)

    def path(self, start: Belief, after: Belief, line: VehicleLine) -> Trajectory:
        """Return the causal solution at full rate, batch shape (B, T)."""
        inside = path_in_blocks(self.model, start, after, line.line)
        return trajectory_of_blocks(line.line, inside, after.state)


def vehicle_line(line: Timeline) -> VehicleLine:
    """Return a timeline as vehicles have it.

    Args:
        line: The drives in blocks.
    """
    return VehicleLine(line.blocks, line, line.occasion.delay)


def _from_first(value: Tensor) -> Tensor:
    return value - value[..., :1, :]


def _before_each(first: BlockEnd, end: BlockEnd) -> BlockEnd:
    """Return the last sample before each block, shape (B, K) each, from those of the blocks."""

    def shifted(start: Tensor, later: Tensor) -> Tensor:
        return torch.cat((start.unsqueeze(1), later[:, :-1]), 1)

    sample = RissSample(*map(shifted, first.sample, end.sample))
    return BlockEnd(sample, shifted(first.acceleration, end.acceleration))
