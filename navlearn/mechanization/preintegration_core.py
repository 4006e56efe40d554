"""Sums over the samples of windows: the formulas of preintegration.

[Forster2017] §VI, with the sums written so that nothing but a product of quaternions is
recursive. With R_k the rotation in the middle of sample k, a_k = R_k Δv_k the velocity it adds
and τ_k the time from its middle to the end, velocity and position increments are Σ a_k and
Σ τ_k a_k. What a small rotation at sample j does to both is the cross product with what is still
to come, A_j = Σ_{k>j} a_k and P_j = Σ_{k>j} τ_k a_k. So every Jacobian is a sum over samples of
(1, τ, A, P) times R, every covariance one of (1, A, P) times (1, A, P): one small matrix product
per window gives all of them.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.mechanization.preintegration_sums import by_force, by_rate, covariance_of
from navlearn.mechanization.preintegration_turn import (
    Quaternion,
    prefix_products,
    quaternions_of,
)


class Preintegrated(NamedTuple):
    """Increments over a window, in the body frame at its start, against inertial space.

    Errors of the increments are in the order of the error state: position 0:3, velocity 3:6,
    rotation 6:9 (the small rotation ψ on the left, R̂ = (I + [ψ×]) R), all in the start's axes.
    Sensor parameters are in the order of the filter: gyro bias 0:3, accelerometer bias 3:6 and,
    when asked for, gyro scale factor 6:9, accelerometer scale factor 9:12.

    Attributes:
        duration: Length of the window, s, shape (...).
        rotation: Unit quaternion that turns the body at the end into the body at the start,
            scalar first, shape (..., 4).
        velocity: ∫ R f dt, m/s, shape (..., 3).
        position: ∫∫ R f dt dt, m, shape (..., 3).
        by_sensor: Derivative of the increments in the sensor parameters that were taken off,
            shape (..., 9, 6) or (..., 9, 12).
        covariance: Covariance of the increments by white noise, shape (..., 9, 9).
    """

    duration: Tensor
    rotation: Tensor
    velocity: Tensor
    position: Tensor
    by_sensor: Tensor
    covariance: Tensor


class Increments(NamedTuple):
    """Samples of N windows, vectors as (3, N, n).

    Attributes:
        turn: Rotation vector, rad.
        speed: Velocity increment seen from the body in the middle of the sample, m/s.
        bent: Rotation times velocity increment, rad m/s.
        dt: Length, s, shape (N, n).
    """

    turn: Tensor
    speed: Tensor
    bent: Tensor
    dt: Tensor


def integrated(
    samples: Increments, gyro: Tensor, accel: Tensor, turn: Tensor | None, scale_factors: bool
) -> Preintegrated:
    """Return the increments of N windows.

    Args:
        samples: Samples of the windows.
        gyro: Spectral density of the rate's noise, rad²/s, shape (1, 1), (N, 1) or (N, n).
        accel: Spectral density of the force's noise, m²/s³, shape (1, 1) or (N, 1).
        turn: What turning adds to the first, times the mean square of the rate, s, shape ().
        scale_factors: Whether to differentiate in the scale factors, too.

    Returns:
        Increments, shape (N,).
    """
    dt = samples.dt
    step = quaternions_of(samples.turn)
    after = prefix_products(step)
    R = _matrices_in_the_middle(after, step[0])
    past = torch.cumsum(dt, -1)
    duration = past[:, -1:]
    tau = torch.add(duration - past, dt, alpha=0.5)
    rows = (R[:3], R[3:6], R[6:])
    speed = [_row_times(row, samples.speed) for row in rows]
    # a force that turns with the body moves it less than half its velocity times the sample
    curve = dt / -12.0
    way = [
        torch.addcmul(tau * v, curve, _row_times(r, samples.bent))
        for v, r in zip(speed, rows, strict=True)
    ]
    added = torch.stack((*way, *speed), 1)
    sums = torch.cumsum(added, -1)
    total = sums[..., -1]
    # half of the sample itself: what its rotation does to its own increment
    to_come = torch.add(total.unsqueeze(-1) - sums, added, alpha=0.5)
    way_to_come = torch.addcmul(to_come[:, :3], added[:, 3:], curve.unsqueeze(1))
    told = torch.cat((way_to_come, to_come[:, 3:], torch.stack((tau, torch.ones_like(tau)), 1)), 1)
    turned = torch.stack(R, 1).transpose(-1, -2)
    timed = told * dt.unsqueeze(1)
    moments = (timed @ turned).reshape(-1, 8, 3, 3)
    by_sensor = [by_rate(moments), by_force(moments)]
    if scale_factors:
        in_turn = (told @ (turned * _columns(samples.turn))).reshape(-1, 8, 3, 3)
        in_speed = (told @ (turned * _columns(samples.speed))).reshape(-1, 8, 3, 3)
        by_sensor += [by_rate(in_turn), by_force(in_speed)]
    if turn is not None:
        # an interval of no length has not turned
        square = (samples.turn * samples.turn).sum(0) / dt.clamp(min=1e-12)
        gyro = gyro + turn * square.sum(-1, keepdim=True) / duration.clamp(min=1e-12)
    if gyro.shape[1] > 1:
        timed, gyro = timed * gyro.unsqueeze(1), torch.ones_like(duration)
    covariance = covariance_of(timed @ told.transpose(-1, -2), gyro, accel, duration)
    return Preintegrated(
        duration.squeeze(-1),
        torch.stack([x[:, -1] for x in after], -1),
        total[:, 3:],
        total[:, :3],
        torch.cat(by_sensor, -1),
        covariance,
    )


def cross_of(left: Tensor, right: Tensor) -> Tensor:
    """Return left × right of vectors whose axes lie first, shape (3, ...)."""
    (a, b, c), (x, y, z) = left.unbind(0), right.unbind(0)
    return torch.stack((_less(b * z, c, y), _less(c * x, a, z), _less(a * y, b, x)))


def _columns(channels: Tensor) -> Tensor:
    """Return (3, N, n) so that it multiplies the columns of flattened matrices (N, n, 9)."""
    return channels.permute(1, 2, 0).repeat(1, 1, 3)


def _matrices_in_the_middle(after: Quaternion, cosine: Tensor) -> list[Tensor]:
    """Return the rotation in the middle of every sample, entries by rows.

    The sum of the quaternions before and after a sample points at its middle; its length is
    that of 2 cos(θ/4).
    """
    shrink = torch.rsqrt(1.0 + cosine)
    w, x, y, z = (
        (q + torch.nn.functional.pad(q[:, :-1], (1, 0), value=1.0 if k == 0 else 0.0)) * shrink
        for k, q in enumerate(after)
    )
    xy, xz, yz = x * y, x * z, y * z
    more, less = torch.addcmul, _less
    one = torch.ones((), dtype=w.dtype, device=w.device)
    return [
        *(less(less(one, y, y), z, z), less(xy, w, z), more(xz, w, y)),
        *(more(xy, w, z), less(less(one, x, x), z, z), less(yz, w, x)),
        *(less(xz, w, y), more(yz, w, x), less(less(one, x, x), y, y)),
    ]


def _less(total: Tensor, left: Tensor, right: Tensor) -> Tensor:
    return torch.addcmul(total, left, right, value=-1.0)


def _row_times(row: list[Tensor], vector: Tensor) -> Tensor:
    x, y, z = vector.unbind(0)
    return torch.addcmul(torch.addcmul(row[0] * x, row[1], y), row[2], z)
