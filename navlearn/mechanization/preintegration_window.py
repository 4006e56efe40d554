"""Preintegration: what the IMU says over a window, whatever state the window starts from.

Increments are inertial: gravity, Earth rate and the start velocity come in with
:func:`navlearn.mechanization.preintegration_predict.predict`. Windows are taken a few hundred at a
time, so that what is computed of them stays in the processor's cache.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.mechanization.preintegration_core import (
    Increments,
    Preintegrated,
    cross_of,
    integrated,
)

__all__ = ["Preintegrated", "preintegrate", "preintegrate_increments"]

TOGETHER = 50_000
"""Samples that are worked on at a time."""


def preintegrate(
    omega_ib_b: Tensor,
    f_b: Tensor,
    dt: Tensor,
    *,
    gyro_random_walk: float | Tensor = 0.0,
    accel_random_walk: float | Tensor = 0.0,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
    turn_noise: float | Tensor | None = None,
    scale_factors: bool = False,
) -> Preintegrated:
    """Integrate windows of mean rates and forces, all at once.

    Within a sample rate and force are taken as constant in the body frame.

    Args:
        omega_ib_b: Mean angular rate of each interval as measured, rad/s, shape (..., n, 3).
        f_b: Mean specific force of each interval as measured, m/s², shape (..., n, 3).
        dt: Length of each interval, s, shape (..., n); zero marks padding and moves nothing.
        gyro_random_walk: Density of the gyros' white noise, the same for the three axes, rad/√s:
            one, one per window or one per sample, shape (), (...) or (..., n).
        accel_random_walk: Density of the accelerometers' white noise, m/s/√s, shape () or (...).
        gyro_bias: Taken off the rate, rad/s, shape (..., 3); None means zero.
        accel_bias: Taken off the force, m/s², shape (..., 3); None means zero.
        gyro_scale: Scale factor, measured = (1 + s) true + bias, shape (..., 3); None means zero.
        accel_scale: The same of the accelerometers.
        turn_noise: What turning adds to the gyros' noise, √s: over a window the density grows by
            its square times the mean square of the rate, shape (); None means nothing.
        scale_factors: Whether to differentiate in the scale factors, too.

    Returns:
        Increments, shape (...).

    Raises:
        ShapeError: If rate, force and intervals do not go together.
    """
    _check(omega_ib_b, f_b, dt)
    n = dt.shape[-1]
    rates, forces, steps = omega_ib_b.reshape(-1, n, 3), f_b.reshape(-1, n, 3), dt.reshape(-1, n)
    biases = (_per_window(gyro_bias, dt), _per_window(accel_bias, dt))
    scales = (_per_window(gyro_scale, dt), _per_window(accel_scale, dt))
    noise = (_density(gyro_random_walk, dt), _density(accel_random_walk, dt))
    parts = []
    for at in _tiles(steps):
        step = steps[at]
        turn = _channels(_true(rates[at], _part(biases[0], at), _part(scales[0], at))) * step
        speed = _channels(_true(forces[at], _part(biases[1], at), _part(scales[1], at))) * step
        bent = cross_of(turn, speed)
        # ∫ exp([ω]s) f ds seen from the middle of the sample is (I + [θ×]²/24) f dt
        middle = torch.add(speed, cross_of(turn, bent), alpha=1.0 / 24.0)
        samples = Increments(turn, middle, bent, step)
        gyro, accel = (x if len(x) == 1 else x[at] for x in noise)
        parts.append(integrated(samples, gyro, accel, _squared(turn_noise, dt), scale_factors))
    return _in_windows(parts, dt.shape[:-1], gyro_scale, accel_scale)


def preintegrate_increments(
    rotation: Tensor,
    velocity: Tensor,
    dt: Tensor,
    *,
    gyro_random_walk: float | Tensor = 0.0,
    accel_random_walk: float | Tensor = 0.0,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
    turn_noise: float | Tensor | None = None,
    scale_factors: bool = False,
) -> Preintegrated:
    """Integrate windows of increments that are compensated for coning and sculling.

    Args:
        rotation: Rotation vector of each interval, rad, shape (..., n, 3).
        velocity: Velocity increment of each interval in the body frame at its start, turning
            within the interval compensated, m/s, shape (..., n, 3).
        dt: Length of each interval, s, shape (..., n); zero marks padding, whose increments must
            be zero, too.
        gyro_random_walk: Density of the gyros' white noise, the same for the three axes, rad/√s:
            one, one per window or one per sample, shape (), (...) or (..., n).
        accel_random_walk: Density of the accelerometers' white noise, m/s/√s, shape () or (...).
        gyro_scale: Scale factor that was taken off the rate, for the derivatives alone, shape
            (..., 3); None means zero.
        accel_scale: The same of the accelerometers.
        turn_noise: What turning adds to the gyros' noise, √s: over a window the density grows by
            its square times the mean square of the rate, shape (); None means nothing.
        scale_factors: Whether to differentiate in the scale factors, too.

    Returns:
        Increments, shape (...).

    Raises:
        ShapeError: If rotation, velocity and intervals do not go together.
    """
    _check(rotation, velocity, dt)
    n = dt.shape[-1]
    turns, pushes, steps = rotation.reshape(-1, n, 3), velocity.reshape(-1, n, 3), dt.reshape(-1, n)
    noise = (_density(gyro_random_walk, dt), _density(accel_random_walk, dt))
    parts = []
    for at in _tiles(steps):
        turn, speed = _channels(turns[at]), _channels(pushes[at])
        bent = cross_of(turn, speed)
        # back by half the rotation; the fourth order is far below what an increment resolves
        middle = torch.add(speed, bent, alpha=-0.5).add(cross_of(turn, bent), alpha=0.125)
        samples = Increments(turn, middle, bent, steps[at])
        gyro, accel = (x if len(x) == 1 else x[at] for x in noise)
        parts.append(integrated(samples, gyro, accel, _squared(turn_noise, dt), scale_factors))
    return _in_windows(parts, dt.shape[:-1], gyro_scale, accel_scale)


def _tiles(steps: Tensor) -> Iterator[slice]:
    count = max(1, TOGETHER // steps.shape[1])
    for first in range(0, max(1, len(steps)), count):
        yield slice(first, first + count)


def _per_window(error: Tensor | None, dt: Tensor) -> Tensor | None:
    return None if error is None else error.expand(*dt.shape[:-1], 3).reshape(-1, 3)


def _part(error: Tensor | None, at: slice) -> Tensor | None:
    return None if error is None else error[at]


def _squared(walk: float | Tensor | None, dt: Tensor) -> Tensor | None:
    if walk is None:
        return None
    return torch.as_tensor(walk, dtype=dt.dtype, device=dt.device) ** 2


def _in_windows(
    parts: list[Preintegrated],
    shape: torch.Size,
    gyro_scale: Tensor | None,
    accel_scale: Tensor | None,
) -> Preintegrated:
    """Return windows in the shape they came in, derivatives by what was measured."""
    pre = parts[0] if len(parts) == 1 else Preintegrated(*map(torch.cat, zip(*parts, strict=True)))
    laid = Preintegrated(*(x.reshape((*shape, *x.shape[1:])) for x in pre))
    if gyro_scale is None and accel_scale is None:
        return laid
    one = torch.ones_like(laid.position)
    gains = [one if x is None else 1.0 + x.expand_as(one) for x in (gyro_scale, accel_scale)]
    gain = torch.cat(gains * (laid.by_sensor.shape[-1] // 6), -1)
    return laid._replace(by_sensor=laid.by_sensor / gain.unsqueeze(-2))


def _check(rate: Tensor, force: Tensor, dt: Tensor) -> None:
    if rate.shape != force.shape or rate.shape != (*dt.shape, 3) or dt.shape[-1:] == (0,):
        raise ShapeError(
            f"preintegration: rate {tuple(rate.shape)}, force {tuple(force.shape)} and intervals "
            f"{tuple(dt.shape)} do not go together; expected (..., n, 3) twice and (..., n)"
        )


def _true(measured: Tensor, bias: Tensor | None, scale: Tensor | None) -> Tensor:
    if bias is not None:
        measured = measured - bias.unsqueeze(-2)
    return measured if scale is None else measured / (1.0 + scale.unsqueeze(-2))


def _density(random_walk: float | Tensor, dt: Tensor) -> Tensor:
    """Return the square of a random walk as (1, 1), (N, 1) or (N, n)."""
    walk = torch.as_tensor(random_walk, dtype=dt.dtype, device=dt.device)
    density = walk * walk
    if density.dim() == dt.dim() and dt.shape[-1] > 1:
        return density.expand(dt.shape).reshape(-1, dt.shape[-1])
    if density.dim() < dt.dim():
        density = density.unsqueeze(-1)
    return density.reshape(-1, 1)


def _channels(vectors: Tensor) -> Tensor:
    """Return (..., n, 3) as (3, N, n), each channel in one piece."""
    return vectors.reshape(-1, vectors.shape[-2], 3).permute(2, 0, 1).contiguous()
