"""What dead reckoning does wrong in a short time, measured against a reference.

Dead reckoning starts anew from the reference again and again, so that each difference is that of
one short stretch alone: run on, it would carry every earlier azimuth error into each later step.
Along and across are axes of the reference's azimuth in the middle of a stretch.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import FitError
from navlearn.frames import enu_between
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import (
    gyro_regressor,
    odometer_acceleration,
    sensor_errors,
    speed_regressor,
)
from navlearn.learning.referenced_drive import ReferencedDrive, states_at
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import RissSample

FEWEST = 60
"""Fewest stretches from which a noise is told."""


class Increments(NamedTuple):
    """Errors (dead reckoning minus reference) of K stretches in which the car moved.

    Attributes:
        place: Number of each stretch in its drive, int64, shape (K,); neighbours differ by 1.
        span: Their length, s.
        along: Forward, m, shape (K,).
        across: To the right, m, shape (K,).
        up: Upwards, m, shape (K,); NaN where the reference tells no height.
        azimuth: Azimuth, rad, shape (K,).
        speed_along: Velocity along, m/s, shape (K,); NaN where the reference tells none.
        speed_across: Velocity to the right, m/s, shape (K,).
        speed_up: Velocity upwards, m/s, shape (K,).
        way: Distance by the odometer, m, shape (K,).
        turned_squared: Integral of the squared yaw rate, rad²/s, shape (K,).
        by_gyro: How each gyro parameter turns a stretch, shape (K, g).
        by_speed: How each odometer parameter lengthens it, shape (K, s).
    """

    place: Tensor
    span: float
    along: Tensor
    across: Tensor
    up: Tensor
    azimuth: Tensor
    speed_along: Tensor
    speed_across: Tensor
    speed_up: Tensor
    way: Tensor
    turned_squared: Tensor
    by_gyro: Tensor
    by_speed: Tensor


def reference_increments(
    drive: ReferencedDrive, options: EkfOptions, span: float = 1.0
) -> Increments:
    """Return the errors of dead reckoning over consecutive stretches of a drive.

    Args:
        drive: The drive.
        options: The filter: its mechanization, and which sensor parameters it has.
        span: Length of a stretch, s.

    Raises:
        FitError: The reference covers too little of the moving drive.
    """
    dt = float(drive.samples.dt.median())
    n = max(round(span / dt), 1)
    count = len(drive.samples.dt) // n
    place = torch.arange(count)
    begin = states_at(drive.reference, place * n)
    end = [channel[(place + 1) * n] for channel in drive.reference]
    blocks = RissSample(*(channel[: count * n].reshape(count, n) for channel in drive.samples))
    moving = (blocks.stationary < 0.5).all(-1) & (blocks.speed > 0.0).all(-1)
    known = torch.stack((*begin[:2], begin.azimuth, *end[:2], end[3])).isfinite().all(0) & moving
    if int(known.sum()) < FEWEST:
        raise FitError(
            f"{drive.name}: the reference tells {int(known.sum())} stretches of {span:g} s in "
            f"which the car moves; {FEWEST} or more tell a noise: use a longer drive"
        )
    place, blocks = place[known], RissSample(*(channel[known] for channel in blocks))
    start = begin._replace(height=begin.height.nan_to_num())
    start = type(start)(*(channel[known] for channel in start))
    lat, lon, height, azimuth, v_e, v_n, v_u = (channel[known] for channel in end)
    ran = riss_over_time(start, blocks, options=options.mechanization)
    last = [channel[..., -1] for channel in ran]
    east, north, up = enu_between(last[0], last[1], last[2], lat, lon, height.nan_to_num())
    middle = 0.5 * (start.azimuth + azimuth)
    sine, cosine = torch.sin(middle), torch.cos(middle)
    off_e, off_n = _velocity_error(ran.v_e, ran.v_n, v_e, v_n, azimuth)
    heights = begin.height[known].isfinite() & height.isfinite()
    return Increments(
        place,
        n * dt,
        east * sine + north * cosine,
        east * cosine - north * sine,
        torch.where(heights, up, torch.nan),
        last[3] - azimuth,
        off_e,
        off_n,
        last[6] - v_u,
        (blocks.speed * blocks.dt).sum(-1),
        (blocks.yaw_rate**2 * blocks.dt).sum(-1),
        *_regressors(options, blocks),
    )


def _velocity_error(
    v_e: Tensor, v_n: Tensor, true_e: Tensor, true_n: Tensor, azimuth: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the velocity error at the end, along and to the right of the reference's azimuth."""
    off_e, off_n = v_e[..., -1] - true_e, v_n[..., -1] - true_n
    sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
    return off_e * sine + off_n * cosine, off_e * cosine - off_n * sine


def _regressors(options: EkfOptions, blocks: RissSample) -> tuple[Tensor, Tensor]:
    """Return what sensor parameters do to the azimuth and the length of each stretch."""
    errors = sensor_errors(options)
    dt = blocks.dt
    terms = ["bias"] if errors.velocity_states else errors.gyro_terms
    gyro = [(gyro_regressor(term, blocks) * dt).sum(-1) for term in terms]
    acceleration = odometer_acceleration(dt, blocks.speed)
    speed = [
        (
            (blocks.speed if term == "scale" else speed_regressor(term, blocks, acceleration)) * dt
        ).sum(-1)
        for term in errors.speed_terms
    ]
    none = dt.new_zeros((len(dt), 0))
    return (
        torch.stack(gyro, -1) if gyro else none,
        torch.stack(speed, -1) if speed else none,
    )
