"""How far a receiver's own deviations are to be believed, by its errors against a reference."""

import torch
from torch import Tensor

from navlearn import earth
from navlearn.learning.referenced_drive import ReferencedDrive

FEWEST = 30
"""Fewest fixes with a known error from which a noise is told."""

VARIED = 1.5
"""Largest deviations over smallest, from which floor and factor can be told apart."""

FAR = 4.0
"""An error beyond so many deviations is an outlier's, which is the gate's business."""

STEADY = 0.02
"""A velocity is judged up to this yaw rate, beyond which the antenna has one of its own, rad/s."""


def receiver_noise(drives: list[ReferencedDrive]) -> dict[str, float]:
    """Return inflations and floors with which deviations fit the errors of fixes.

    Errors are taken as white: variance = (inflation · deviation)² + floor². Where a receiver always
    tells about the same deviation only their sum is known, and the floor is left as it is.

    Args:
        drives: Drives with a reference.

    Returns:
        Entries of :class:`navlearn.fusion.noise_options.NoiseOptions` by name; fewer where fixes
        or reference tell no velocity or height.
    """
    level, told_level = _pooled([_position_errors(drive) for drive in drives])
    up, told_up = _pooled([_height_errors(drive) for drive in drives])
    speed, told_speed = _pooled([_velocity_errors(drive) for drive in drives])
    found: dict[str, float] = {}
    for name, error, told in (("position", level, told_level), ("velocity", speed, told_speed)):
        fit = _inflation_and_floor(error, told)
        if fit is not None:
            found[f"{name}_inflation"] = fit[0]
            if fit[1] is not None:
                found[f"{name}_floor"] = fit[1]
    inflation = found.get("position_inflation")
    if inflation is not None and len(up) >= FEWEST:
        # one factor serves position and height; the floor takes what it leaves of the height
        kept = up.abs() <= FAR * up.square().median().sqrt() / 0.6745
        rest = up[kept].square().mean() - inflation**2 * told_up[kept].square().mean()
        found["height_floor"] = max(float(rest), 0.0) ** 0.5
    return found


def _inflation_and_floor(error: Tensor, told: Tensor) -> tuple[float, float | None] | None:
    """Return factor and floor of deviations; None for a floor that cannot be told."""
    if len(error) < FEWEST:
        return None
    kept = torch.ones_like(error, dtype=torch.bool)
    factor, floor = torch.ones_like(error[0]), torch.zeros_like(error[0])
    low, high = torch.quantile(told, torch.tensor([0.1, 0.9], dtype=told.dtype))
    varied = bool(high > VARIED * low)
    for _ in range(5):
        square, variance = error[kept].square(), told[kept].square()
        weight = 1.0 / (factor**2 * variance + floor**2) ** 2
        factor2, floor2 = (
            _two_not_negative(square, variance, weight)
            if varied
            else (
                square.mean() / variance.mean(),
                torch.zeros_like(floor),
            )
        )
        factor, floor = factor2.clamp(min=1e-12).sqrt(), floor2.sqrt()
        spread = (factor**2 * told**2 + floor**2).sqrt()
        # a robust measure of how far errors reach, so that spikes do not make room for spikes
        robust = (error / spread).abs().median() / 0.6745
        kept = (error / spread).abs() <= FAR * robust
    return float(factor), float(floor) if varied else None


def _two_not_negative(square: Tensor, variance: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Return a and b ≥ 0 of square ≈ a · variance + b by weighted least squares."""
    one = torch.ones_like(variance)
    columns = torch.stack((variance, one), -1)
    normal = columns.T @ (weight[:, None] * columns)
    right = columns.T @ (weight * square)
    a, b = torch.linalg.solve(normal, right)
    if a < 0.0:
        return torch.zeros_like(a), right[1] / normal[1, 1]
    if b < 0.0:
        return right[0] / normal[0, 0], torch.zeros_like(b)
    return a, b


def _pooled(parts: list[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    error, told = (torch.cat([part[k] for part in parts]) for k in (0, 1))
    known = error.isfinite() & told.isfinite()
    return error[known], told[known]


def _position_errors(drive: ReferencedDrive) -> tuple[Tensor, Tensor]:
    """Return errors of fixes east and north and the deviations told, m, shape (2 M,) each."""
    fixes, at = drive.fixes, drive.at_fixes
    north = (fixes.lat - at.lat) * earth.meridian_radius(at.lat)
    east = (fixes.lon - at.lon) * earth.prime_vertical_radius(at.lat) * torch.cos(at.lat)
    right, forward, _ = drive.lever_arm
    sine, cosine = torch.sin(at.azimuth), torch.cos(at.azimuth)
    if right != 0.0 or forward != 0.0:
        east = east - (right * cosine + forward * sine)
        north = north - (forward * cosine - right * sine)
    there = fixes.has_position > 0.5
    none = torch.full_like(east, torch.nan)
    errors = torch.where(there, east, none), torch.where(there, north, none)
    return torch.cat(errors), torch.cat((fixes.std_e, fixes.std_n))


def _height_errors(drive: ReferencedDrive) -> tuple[Tensor, Tensor]:
    fixes = drive.fixes
    # a receiver that tells no height is given a deviation of a kilometre
    there = (fixes.has_position > 0.5) & (fixes.std_u < 500.0)
    error = fixes.height - drive.at_fixes.height - drive.lever_arm[2]
    return torch.where(there, error, torch.nan), fixes.std_u


def _velocity_errors(drive: ReferencedDrive) -> tuple[Tensor, Tensor]:
    fixes, at = drive.fixes, drive.at_fixes
    rate = drive.samples.yaw_rate[drive.timing.index.clamp(min=0)]
    there = (fixes.has_velocity > 0.5) & (rate.abs() < STEADY)
    none = torch.full_like(fixes.v_e, torch.nan)
    errors = (
        torch.where(there, fixes.v_e - at.v_e, none),
        torch.where(there, fixes.v_n - at.v_n, none),
    )
    return torch.cat(errors), torch.cat((fixes.std_v, fixes.std_v))
