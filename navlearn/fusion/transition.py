"""Transition and process noise of a block for the ``bias_scale`` error states, in closed form.

The error dynamics are nilpotent: azimuth is driven by gyro errors, position by azimuth and by
odometer and pitch errors, nothing drives back. Products of transition matrices are then sums
along the block: with W the way that is still ahead at a sample, an azimuth error that enters
there ends as a position error W turned by 90°.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.block_motion import BlockMotion
from navlearn.fusion.noise import EkfNoise, azimuth_density, height_density, walk_densities
from navlearn.fusion.sensor_errors import (
    SensorErrors,
    decay_over,
    decaying,
    gyro_regressor,
    speed_regressor,
)
from navlearn.states import RissSample

# transposed Cholesky factor of the 3 by 3 Hilbert matrix: ∫ xᵃ xᵇ dx over [0, 1]
_HILBERT = (
    (1.0, 0.5, 1.0 / 3.0),
    (0.0, math.sqrt(1.0 / 12.0), math.sqrt(1.0 / 12.0)),
    (0.0, 0.0, math.sqrt(1.0 / 180.0)),
)


class Linearised(NamedTuple):
    """How the error moves through a block.

    Attributes:
        transition: Φ, shape (..., n, n).
        noise: Q, shape (..., n, n).
    """

    transition: Tensor
    noise: Tensor


class _Levers(NamedTuple):
    """Way still ahead of the middle of each sample, m, shape (..., n) each."""

    east: Tensor
    north: Tensor


class _SensorColumns(NamedTuple):
    """Effect of sensor errors over the block on (east, north, up, azimuth), shape (..., m).

    ``by_turn`` is what goes through the azimuth, ``direct`` what does not.
    """

    azimuth: list[Tensor]
    by_turn: list[tuple[Tensor, Tensor]]
    direct: list[tuple[Tensor, Tensor, Tensor]]


def bias_scale_transition(
    errors: SensorErrors,
    moved: BlockMotion,
    samples: RissSample,
    acceleration: Tensor,
    sensor: Tensor,
    noise: EkfNoise,
) -> Linearised:
    """Return transition and process noise of blocks.

    Args:
        errors: Sensor parameters of the filter.
        moved: The blocks as mechanized.
        samples: Their samples, shape (..., n) each.
        acceleration: Forward acceleration by the odometer, m/s², shape (..., n).
        sensor: Sensor parameters at the start of each block, shape (..., m).
        noise: Noise densities.

    Returns:
        Φ and Q, shape (..., 4 + m, 4 + m) each.
    """
    levers = _Levers(_ahead(moved.east), _ahead(moved.north))
    columns = _sensor_columns(errors, moved, levers, samples, acceleration, sensor)
    duration = samples.dt.sum(-1)
    return Linearised(
        _transition(errors, moved, columns, duration),
        _noise(errors, moved, levers, columns, samples, duration, noise),
    )


def _ahead(way: Tensor) -> Tensor:
    sums = torch.cumsum(way, -1)
    return sums[..., -1:] - sums + 0.5 * way


def _dot(left: Tensor, right: Tensor) -> Tensor:
    return (left * right).sum(-1)


def _sensor_columns(
    errors: SensorErrors,
    moved: BlockMotion,
    levers: _Levers,
    samples: RissSample,
    acceleration: Tensor,
    sensor: Tensor,
) -> _SensorColumns:
    motion = moved.motion
    zero = torch.zeros_like(moved.end.lat)
    azimuth: list[Tensor] = []
    by_turn: list[tuple[Tensor, Tensor]] = []
    direct: list[tuple[Tensor, Tensor, Tensor]] = []

    def add_turn(angle: Tensor) -> None:
        azimuth.append(angle.sum(-1))
        by_turn.append((_dot(levers.north, angle), -_dot(levers.east, angle)))

    pitch = samples.pitch - sensor[..., -1:] if errors.pitch_bias else samples.pitch
    angle = motion.dt
    if errors.tilt_compensation:
        angle = angle / (torch.cos(pitch) * torch.cos(samples.roll))
    for term in errors.gyro_terms:
        if term == "bias":
            add_turn(angle if errors.correlation_time == 0.0 else angle * moved.decay)
        else:
            add_turn(angle * gyro_regressor(term, samples))
        direct.append((zero, zero, zero))
    scale = zero
    if "scale" in errors.speed_terms:
        scale = sensor[..., len(errors.gyro_terms) + errors.speed_terms.index("scale")]
    per_scale = 1.0 / (1.0 + scale)
    for term in errors.speed_terms:
        azimuth.append(zero)
        by_turn.append((zero, zero))
        if term == "scale":
            ways = (moved.east, moved.north, moved.up)
            east, north, up = (-per_scale * way.sum(-1) for way in ways)
        else:
            level = speed_regressor(term, samples, acceleration) * motion.dt
            climb = level * torch.sin(pitch) if errors.three_d else torch.zeros_like(level)
            level = level * torch.cos(pitch) if errors.three_d else level
            east = per_scale * _dot(level, moved.sine)
            north = per_scale * _dot(level, moved.cosine)
            up = per_scale * climb.sum(-1)
        direct.append((east, north, up))
    if errors.pitch_bias:
        # of the pitch, without another sine; where the car stands nothing is multiplied by it
        rolling = motion.v_h != 0.0
        tangent = torch.where(rolling, motion.v_u / torch.where(rolling, motion.v_h, 1.0), 0.0)
        if errors.tilt_compensation:
            add_turn(-motion.turn * tangent)
        else:
            azimuth.append(zero)
            by_turn.append((zero, zero))
        ways_up = -_dot(motion.v_h, motion.dt)
        direct.append((_dot(tangent, moved.east), _dot(tangent, moved.north), ways_up))
    return _SensorColumns(azimuth, by_turn, direct)


def _transition(
    errors: SensorErrors, moved: BlockMotion, columns: _SensorColumns, duration: Tensor
) -> Tensor:
    zero = torch.zeros_like(duration)
    m = len(columns.azimuth)
    east = [moved.north.sum(-1)]
    north = [-moved.east.sum(-1)]
    up = [zero]
    azimuth = [zero]
    for j in range(m):
        east.append(columns.by_turn[j][0] + columns.direct[j][0])
        north.append(columns.by_turn[j][1] + columns.direct[j][1])
        up.append(columns.direct[j][2])
        azimuth.append(columns.azimuth[j])
    top = torch.stack([*east, *north, *up, *azimuth], dim=-1).reshape(*zero.shape, 4, 1 + m)
    moves = torch.nn.functional.pad(top, (3, 0, 0, m))
    return moves + torch.diag_embed(_kept(errors, duration, 4 + m))


def _kept(errors: SensorErrors, duration: Tensor, n: int) -> Tensor:
    kept = torch.ones((*duration.shape, n), dtype=duration.dtype, device=duration.device)
    if errors.correlation_time == 0.0:
        return kept
    returning = torch.tensor([False] * (n - 2 if errors.velocity_states else 4) + decaying(errors))
    left = decay_over(errors, duration).unsqueeze(-1)
    return torch.where(returning.to(duration.device), left, kept)


def _noise(
    errors: SensorErrors,
    moved: BlockMotion,
    levers: _Levers,
    columns: _SensorColumns,
    samples: RissSample,
    duration: Tensor,
    noise: EkfNoise,
) -> Tensor:
    q = azimuth_density(samples, noise) * moved.motion.dt
    q_e, q_n = q * levers.north, -q * levers.east
    s, s_e, s_n = q.sum(-1), q_e.sum(-1), q_n.sum(-1)
    s_ee, s_nn = _dot(q_e, levers.north), -_dot(q_n, levers.east)
    s_en = -_dot(q_e, levers.east)
    moving = moved.motion.dt.sum(-1)
    walk, climb = noise.position_walk**2 * moving, height_density(errors, noise) * moving
    zero = torch.zeros_like(s)
    entries = [
        *(s_ee + walk, s_en, zero, s_e),
        *(s_en, s_nn + walk, zero, s_n),
        *(zero, zero, climb, zero),
        *(s_e, s_n, zero, s),
    ]
    m = len(columns.azimuth)
    top = torch.nn.functional.pad(torch.stack(entries, -1).reshape(*zero.shape, 4, 4), (0, m, 0, m))
    root = _sensor_noise_root(errors, columns, duration, noise)
    return top if root is None else top + root.transpose(-1, -2) @ root


def _sensor_noise_root(
    errors: SensorErrors, columns: _SensorColumns, duration: Tensor, noise: EkfNoise
) -> Tensor | None:
    """Return a root of the covariance that walking sensor errors leave, shape (..., 3 j, n).

    Their effect after the share x of the block that is still ahead is e + x c₁ + x² c₂.
    """
    walks = [(j, d) for j, d in enumerate(walk_densities(errors, noise)) if d is not None]
    if not walks:
        return None
    zero = torch.zeros_like(duration)
    m = len(columns.azimuth)
    entries: list[Tensor] = []
    for j, _ in walks:
        entries += [*columns.direct[j], columns.azimuth[j], *columns.by_turn[j], zero, zero]
    effects = torch.stack(entries, -1).reshape(*zero.shape, len(walks), 2, 4)
    unit = torch.eye(4 + m, dtype=zero.dtype, device=zero.device)[[4 + j for j, _ in walks]]
    units = unit.unsqueeze(-2).expand(*zero.shape, len(walks), 1, 4 + m)
    powers = torch.cat((units, torch.nn.functional.pad(effects, (0, m))), -2)
    length = torch.sqrt(duration.clamp(min=1e-300)).unsqueeze(-1)
    size = (torch.stack([d for _, d in walks]) * length).unsqueeze(-1).unsqueeze(-1)
    hilbert = torch.tensor(_HILBERT, dtype=zero.dtype, device=zero.device)
    return (size * (hilbert @ powers)).flatten(-3, -2)
