"""The mechanization of one block of samples, with what its linearisation needs.

A block is about a second long: radii and the Earth's vertical rate are those at its start
(carried to its middle where that shows), and the transport rate turns the direction to first
order. Against :func:`navlearn.mechanization.riss_parallel.riss_over_time` that leaves less than
half a micrometre per block. All blocks of a drive may stand in the batch.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.fusion.sensor_errors import SensorErrors, corrected_motion, decay_over
from navlearn.mechanization.motion import RissMotion
from navlearn.states import NavState, RissSample


class BlockMotion(NamedTuple):
    """How a block moves the car, shape (...) per block and (..., n) per sample.

    Attributes:
        end: State at the end of the block.
        motion: Motion of each sample, sensor errors removed.
        decay: What is left of a Gauss–Markov deviation at each sample; (..., 1) of ones for a
            random walk.
        sine: Sine of each mid-interval azimuth.
        cosine: Cosine of each mid-interval azimuth.
        east: Way to the east in each interval, m.
        north: Way to the north in each interval, m.
        up: Way up in each interval, m.
        turn: Change of azimuth in each interval, rad.
        per_lat: 1/(R_M + h), rad/m.
        per_lon: 1/((R_N + h) cos φ) at the block's middle, rad/m.
    """

    end: NavState
    motion: RissMotion
    decay: Tensor
    sine: Tensor
    cosine: Tensor
    east: Tensor
    north: Tensor
    up: Tensor
    turn: Tensor
    per_lat: Tensor
    per_lon: Tensor


def move_block(
    errors: SensorErrors,
    start: NavState,
    sensor: Tensor,
    anchor: Tensor,
    samples: RissSample,
    acceleration: Tensor,
    earth_rate: float,
) -> BlockMotion:
    """Move the car through blocks of samples, all samples at once.

    Args:
        errors: Sensor parameters of the filter.
        start: State at the start of each block, shape (...) each.
        sensor: Sensor parameters there, shape (..., m).
        anchor: Their values at alignment, shape (..., m).
        samples: Samples, shape (..., n) each; dt = 0 pads.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).
        earth_rate: Rotation rate of the Earth, rad/s; zero drops the transport rate too.

    Returns:
        Motion of the blocks.
    """
    decay = torch.ones_like(samples.dt[..., :1])
    if errors.correlation_time > 0.0:
        decay = decay_over(errors, _to_middle(samples.dt))
    motion = corrected_motion(
        errors, samples, acceleration, sensor.unsqueeze(-2), anchor.unsqueeze(-2), decay
    )
    sin_lat, cos_lat = torch.sin(start.lat), torch.cos(start.lat)
    up = motion.v_u * motion.dt
    height = start.height + 0.5 * up.sum(-1)
    per_lat = 1.0 / (earth.meridian_radius(start.lat) + height)
    radius = earth.prime_vertical_radius(start.lat) + height
    turn = motion.turn + (earth_rate * sin_lat).unsqueeze(-1) * motion.dt
    azimuth = start.azimuth.unsqueeze(-1) + _to_middle(turn)
    sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
    way = motion.v_h * motion.dt
    if earth_rate != 0.0:
        transport = (sin_lat / (cos_lat * radius)).unsqueeze(-1) * (way * sine)
        more = _to_middle(transport)
        sine, cosine = sine + cosine * more, cosine - sine * more
        turn = turn + transport
    east, north = way * sine, way * cosine
    d_lat = north.sum(-1) * per_lat
    per_lon = 1.0 / (radius * torch.cos(start.lat + 0.5 * d_lat))
    # the Earth's vertical rate grows towards the pole: half the block's change in latitude
    polewards = 0.5 * earth_rate * cos_lat * d_lat * motion.dt.sum(-1)
    end = NavState(
        start.lat + d_lat,
        start.lon + east.sum(-1) * per_lon,
        start.height + up.sum(-1),
        start.azimuth + turn.sum(-1) + polewards,
    )
    return BlockMotion(end, motion, decay, sine, cosine, east, north, up, turn, per_lat, per_lon)


def _to_middle(increments: Tensor) -> Tensor:
    return torch.cumsum(increments, -1) - 0.5 * increments
