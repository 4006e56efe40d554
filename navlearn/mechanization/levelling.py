"""Levelling: what a standing car's accelerometers and gyros tell of its attitude and themselves.

At rest the specific force is gravity's reaction, which gives pitch and roll ([Groves2013]
Eq. (5.101), turned to RFU); a bias of an accelerometer tips the result by bias/g. The gyros read
their biases and the Earth rate.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_angles
from navlearn.states import ImuSample

TRIM = 0.5
"""The end of a standstill that is not used, s: it is believed until the car is seen to move."""


class Rest(NamedTuple):
    """One stretch of standstill.

    Attributes:
        first: Its first interval.
        last: The last interval that is used.
        duration: Length of what is used, s.
        omega_ib_b: Mean angular rate, rad/s, shape (3,).
        f_b: Mean specific force, m/s², shape (3,).
    """

    first: int
    last: int
    duration: float
    omega_ib_b: Tensor
    f_b: Tensor


def tilt_at_rest(f_b: Tensor) -> tuple[Tensor, Tensor]:
    """Return pitch and roll of a body at rest.

    [Groves2013] Eq. (5.101) for RFU axes.

    Args:
        f_b: Specific force, m/s², shape (..., 3); only its direction matters.

    Returns:
        Pitch (nose up) and roll (right side down), rad, shape (...) each.
    """
    f_x, f_y, f_z = f_b.unbind(-1)
    return torch.atan2(f_y, torch.hypot(f_x, f_z)), torch.atan2(-f_x, f_z)


def gyro_bias_at_rest(
    omega_ib_b: Tensor, f_b: Tensor, lat: Tensor, azimuth: Tensor | None = None
) -> Tensor:
    """Return the biases of gyros that rest on the turning Earth.

    Args:
        omega_ib_b: Mean measured angular rate, rad/s, shape (..., 3).
        f_b: Mean specific force, m/s², shape (..., 3): it levels the Earth rate.
        lat: Latitude, rad, shape (...).
        azimuth: Azimuth, rad, shape (...); None leaves the horizontal Earth rate in the bias
            (0.004 °/s at most).

    Returns:
        Biases, rad/s, shape (..., 3).
    """
    pitch, roll = tilt_at_rest(f_b)
    turning = earth.earth_rate_enu(lat)
    if azimuth is None:
        azimuth = torch.zeros_like(pitch)
        turning = turning * turning.new_tensor([0.0, 0.0, 1.0])
    C_lb = matrix_from_angles(azimuth, pitch, roll)
    return omega_ib_b - (C_lb.transpose(-1, -2) @ turning.unsqueeze(-1)).squeeze(-1)


def last_rest(samples: ImuSample, end: int, duration: float) -> Rest | None:
    """Return the last standstill of a drive that is long enough and over before an interval.

    Args:
        samples: Intervals, shape (T,) and (T, 3) each.
        end: Only intervals before this one are looked at.
        duration: Shortest standstill, s.

    Returns:
        The standstill (what of it lies before ``end``), less its last half second, or None.
    """
    still = (samples.stationary[:end] > 0.5).to(torch.int8)
    change = torch.diff(still, prepend=still.new_zeros(1), append=still.new_zeros(1))
    starts, stops = torch.nonzero(change > 0)[:, 0], torch.nonzero(change < 0)[:, 0]
    clock = torch.cumsum(samples.dt[:end], 0)
    length = clock[stops - 1] - clock[starts] + samples.dt[starts] if len(starts) else clock[:0]
    good = torch.nonzero(length >= duration - 1e-9)
    if len(good) == 0:
        return None
    run = int(good[-1])
    first = int(starts[run])
    until = clock[stops[run] - 1] - min(TRIM, 0.5 * float(length[run]))
    stop = max(int(torch.searchsorted(clock, until + 1e-9)), first + 1)
    used = samples.dt[first:stop].sum()
    weight = (samples.dt[first:stop] / used).unsqueeze(-1)
    return Rest(
        first,
        stop - 1,
        float(used),
        (samples.omega_ib_b[first:stop] * weight).sum(0),
        (samples.f_b[first:stop] * weight).sum(0),
    )
