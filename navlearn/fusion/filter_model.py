"""One filter's choices made ready, and its prediction over blocks."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import wgs84
from navlearn.filters.belief import Belief
from navlearn.filters.consistency import chi_square_quantile
from navlearn.frames import shift_between, shift_geodetic
from navlearn.fusion.block_motion import BlockMotion, move_block
from navlearn.fusion.error_state import (
    ErrorLayout,
    error_layout,
    shifted,
)
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ground_velocity import BlockEnd, odometry
from navlearn.fusion.measured import MeasurementModel
from navlearn.fusion.measurements import Rows, measurement_rows
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import SensorErrors, advanced, sensor_errors
from navlearn.fusion.shen_transition import move_offset, shen_transition
from navlearn.fusion.transition import Linearised, bias_scale_transition
from navlearn.states import NavState, RissSample


@dataclass(frozen=True)
class FilterModel:
    """A filter's choices made ready.

    Attributes:
        options: The choices.
        errors: Sensor parameters.
        layout: Order of the error states.
        rows: Rows of each kind of measurement.
        measurement: What the measurement functions need.
        limits: Largest NIS that the gate lets pass, per kind taken.
        earth_rate: Rotation rate of the Earth that the gyro senses, rad/s.
    """

    options: EkfOptions
    errors: SensorErrors
    layout: ErrorLayout
    rows: Rows
    measurement: MeasurementModel
    limits: tuple[float, ...]
    earth_rate: float

    @property
    def full(self) -> bool:
        """Whether the Shen model is the repaired one."""
        return self.options.model == "shen2010_full"

    @property
    def gate(self) -> GateOptions:
        """When a measurement is refused."""
        return self.options.gate

    @property
    def anchor(self) -> None:
        """Nothing vouches for the others: each kind resets the gate for itself."""
        return

    @property
    def company(self) -> tuple[int, ...]:
        """Nothing, as there is no anchor."""
        return ()

    @property
    def closed(self) -> bool:
        """Whether estimated errors are fed back."""
        return self.options.feedback == "closed"


def filter_model(options: EkfOptions) -> FilterModel:
    """Return a filter's choices made ready.

    Args:
        options: The choices.

    Returns:
        Model.
    """
    errors, layout, rows = sensor_errors(options), error_layout(options), measurement_rows(options)
    rate = wgs84.EARTH_RATE if options.mechanization.earth_rate else 0.0
    arm = options.lever_arm if any(x != 0.0 for x in options.lever_arm) else None
    measurement = MeasurementModel(
        errors, layout, rows, arm, rate, options.course_speed, options.standstill
    )
    limits = tuple(chi_square_quantile(options.gate.probability, n) for n in rows.count)
    return FilterModel(options, errors, layout, rows, measurement, limits, rate)


class Prediction(NamedTuple):
    """Blocks as predicted from a state, with their linearisation there.

    Attributes:
        state: State at the end, shape (...) each.
        sensor: Sensor parameters at the end, shape (..., m).
        velocity_offset: Velocity offset at the end, m/s, shape (..., 3).
        linearised: Φ and Q.
    """

    state: NavState
    sensor: Tensor
    velocity_offset: Tensor
    linearised: Linearised


def predict_blocks(
    model: FilterModel,
    start: Belief,
    samples: RissSample,
    acceleration: Tensor,
    noise: EkfNoise,
) -> Prediction:
    """Return the prediction over blocks, all samples of all blocks at once.

    Args:
        model: The filter.
        start: Belief at the start of each block, batch shape (...); its covariance is not used.
        samples: Samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).
        noise: Noise densities.

    Returns:
        Prediction, batch shape (...).
    """
    errors, ahead = model.errors, carried_blocks(model, start, samples, acceleration)
    moved = ahead.motion
    if model.layout.has_velocity:
        linear = shen_transition(errors, moved, samples, acceleration, noise, model.full)
    else:
        linear = bias_scale_transition(errors, moved, samples, acceleration, start.sensor, noise)
    return Prediction(ahead.state, ahead.sensor, ahead.velocity_offset, linear)


class CarriedBlocks(NamedTuple):
    """Blocks as mechanized from a state.

    Attributes:
        motion: How the blocks move the car by odometer and gyro.
        way: How far they move it in all, east, north, up, m, shape (..., 3).
        state: State at the end, shape (...) each.
        sensor: Sensor parameters at the end, shape (..., m).
        velocity_offset: Velocity offset at the end, m/s, shape (..., 3).
    """

    motion: BlockMotion
    way: Tensor
    state: NavState
    sensor: Tensor
    velocity_offset: Tensor


def carried_blocks(
    model: FilterModel, start: Belief, samples: RissSample, acceleration: Tensor
) -> CarriedBlocks:
    """Return beliefs moved through blocks, all samples of all blocks at once.

    Args:
        model: The filter.
        start: Belief at the start of each block, batch shape (...); its covariance is not used.
        samples: Samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).

    Returns:
        What comes of them, batch shape (...).
    """
    errors = model.errors
    moved = move_block(
        errors, start.state, start.sensor, start.anchor, samples, acceleration, model.earth_rate
    )
    sensor = advanced(errors, start.sensor, start.anchor, samples.dt.sum(-1))
    way = torch.stack((moved.east.sum(-1), moved.north.sum(-1), moved.up.sum(-1)), -1)
    if not model.layout.has_velocity:
        return CarriedBlocks(moved, way, moved.end, sensor, start.velocity_offset)
    offset = move_offset(errors, moved, samples, start.sensor, start.velocity_offset)
    end, more = moved.end, offset.way[..., -1, :]
    lat, lon, height = shift_geodetic(end.lat, end.lon, end.height, *more.unbind(-1))
    state = NavState(lat, lon, height, end.azimuth)
    return CarriedBlocks(moved, way + more, state, sensor, offset.offset)


def fed_back(model: FilterModel, belief: Belief, correction: Tensor, end: BlockEnd) -> Belief:
    """Return a belief moved by a correction; its covariance stays as it is.

    Args:
        model: The filter.
        belief: Belief at the end of a block, batch shape (...).
        correction: In the order of the error state, shape (..., n).
        end: Last sample of the block, shape (...) each.

    Returns:
        Belief.
    """
    layout = model.layout
    state = shifted(belief.state, correction, layout.azimuth)
    sensor = belief.sensor + correction[..., layout.first_sensor :]
    offset = belief.velocity_offset
    if layout.has_velocity:
        turned = velocity_by_turn(model, belief, end) * correction[..., 6:7]
        offset = offset + correction[..., 3:6] - turned
    return belief._replace(state=state, sensor=sensor, velocity_offset=offset)


def difference(model: FilterModel, belief: Belief, other: Belief, end: BlockEnd) -> Tensor:
    """Return minus the correction by which ``fed_back`` moves ``belief`` to ``other``.

    Args:
        model: The filter.
        belief: Belief at the end of a block, batch shape (...).
        other: Belief nearby, batch shape (...).
        end: Last sample of the block, shape (...) each.

    Returns:
        ``belief`` minus ``other`` in the order of the error state, shape (..., n).
    """
    position = -torch.stack(shift_between(*other.state[:3], *belief.state[:3]), -1)
    turn = (belief.state.azimuth - other.state.azimuth).unsqueeze(-1)
    parts = [position, turn, belief.sensor - other.sensor]
    if model.layout.has_velocity:
        velocity = belief.velocity_offset - other.velocity_offset
        parts.insert(1, velocity + velocity_by_turn(model, belief, end) * turn)
    return torch.cat(parts, -1)


def velocity_by_turn(model: FilterModel, belief: Belief, end: BlockEnd) -> Tensor:
    """Return how the velocity by odometer and azimuth changes with the azimuth.

    Args:
        model: The filter.
        belief: Belief at the end of a block, batch shape (...).
        end: Last sample of the block, shape (...) each.

    Returns:
        East, north, up, m/s per rad, shape (..., 3).
    """
    told = odometry(model.errors, end, belief.sensor)
    sine, cosine = torch.sin(belief.state.azimuth), torch.cos(belief.state.azimuth)
    return torch.stack((told.v_h * cosine, -told.v_h * sine, torch.zeros_like(sine)), -1)
