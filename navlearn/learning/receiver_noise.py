"""How far a receiver's own deviations are to be believed, by its errors against a reference.

Most of a fix's error is that of the fix before: ionosphere and reflections change in minutes. A
filter takes errors as white; what many such fixes say together is then told by the white noise of
the same density, which is larger by the sum of the correlations over all lags
([BarShalom2001] §8, coloured measurement noise).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import wrap_angle
from navlearn.learning.referenced_drive import ReferencedDrive

FEWEST = 30
"""Fewest fixes with a known error from which a noise is told."""

VARIED = 1.5
"""Largest deviations over smallest, from which floor and factor can be told apart."""

WINDOW = 5.0
"""Correlations are summed over so many times their own sum: further out they are noise."""

FAR = 4.0
"""An error beyond so many deviations is an outlier's, which is the gate's business."""

STEADY = 0.02
"""A velocity is judged up to this yaw rate, beyond which the antenna has one of its own, rad/s."""


class ReceiverNoise(NamedTuple):
    """What errors of fixes tell of a filter's options.

    Attributes:
        noise: Entries of :class:`navlearn.fusion.noise_options.NoiseOptions` by name; fewer where
            fixes or reference tell no velocity or height.
        lasting: By how much the variance of ``position``, ``height`` and ``velocity`` was raised
            for errors that last; 1 for white ones.
    """

    noise: dict[str, float]
    lasting: dict[str, int | float]


class _Errors(NamedTuple):
    """Errors and deviations of one kind, one series per drive and axis."""

    series: list[tuple[Tensor, Tensor]]

    def known(self) -> tuple[Tensor, Tensor]:
        error, told = (torch.cat([one[k] for one in self.series]) for k in (0, 1))
        there = error.isfinite() & told.isfinite()
        return error[there], told[there]


def receiver_noise(drives: list[ReferencedDrive], *, lasting: bool = True) -> ReceiverNoise:
    """Return inflations and floors with which deviations fit the errors of fixes.

    Variance = (inflation · deviation)² + floor². Where a receiver always tells about the same
    deviation only their sum is known, and the floor is left as it is.

    Args:
        drives: Drives with a reference.
        lasting: Whether errors that last count for as little as they say.
    """
    level = _Errors([one for drive in drives for one in _position_errors(drive)])
    speed = _Errors([one for drive in drives for one in _velocity_errors(drive)])
    up = _Errors([_height_errors(drive) for drive in drives])
    kinds = {"position": level, "velocity": speed, "height": up}
    kinds = {name: kind for name, kind in kinds.items() if len(kind.known()[0]) >= FEWEST}
    factors = {
        name: integrated_correlation(kind) if lasting else 1.0 for name, kind in kinds.items()
    }
    noise: dict[str, float] = {}
    for name in ("position", "velocity"):
        if name in kinds:
            factor, floor = _inflation_and_floor(*kinds[name].known())
            noise[f"{name}_inflation"] = factor * factors[name] ** 0.5
            if floor is not None:
                noise[f"{name}_floor"] = floor * factors[name] ** 0.5
    if "height" in kinds and "position" in kinds:
        # one inflation serves position and height; the floor takes what it leaves of the height
        error, told = up.known()
        kept = error.abs() <= FAR * _robust(error)
        told_square = noise["position_inflation"] ** 2 * told[kept].square().mean()
        rest = factors["height"] * error[kept].square().mean() - told_square
        noise["height_floor"] = max(float(rest), 0.0) ** 0.5
    return ReceiverNoise(noise, dict(factors))


def integrated_correlation(errors: _Errors) -> float:
    """Return the sum of correlations over all lags, 1 + 2 Σ ρ, up to where they end.

    Where they end is found by the automatic window of [Sokal1997].

    Args:
        errors: Series at even intervals; outliers are cut to :data:`FAR` deviations.
    """
    limit = FAR * _robust(errors.known()[0])
    cut = [one.clamp(-limit, limit) for one, _ in errors.series]
    there = [one.isfinite() for one in cut]
    filled = [one.nan_to_num() for one in cut]
    longest = max(len(one) for one in filled) // 4
    power = sum(float((one * one).sum()) for one in filled) / sum(int(one.sum()) for one in there)
    total = 1.0
    if power == 0.0:
        return total
    for lag in range(1, longest):
        products = sum(float((one[lag:] * one[:-lag]).sum()) for one in filled)
        count = sum(int((one[lag:] & one[:-lag]).sum()) for one in there)
        if count < FEWEST:
            break
        correlation = products / count / power
        if correlation <= 0.0 or lag > WINDOW * 0.5 * total:
            break
        total += 2.0 * correlation
    return total


def _robust(error: Tensor) -> Tensor:
    return error.abs().median() / 0.6745


def _inflation_and_floor(error: Tensor, told: Tensor) -> tuple[float, float | None]:
    """Return factor and floor of deviations; None for a floor that cannot be told."""
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
        kept = (error / spread).abs() <= FAR * _robust(error / spread)
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


def _position_errors(drive: ReferencedDrive) -> list[tuple[Tensor, Tensor]]:
    """Return errors of fixes and the deviations told, m, east and north, shape (M,) each."""
    fixes, at = drive.fixes, drive.at_fixes
    north = (fixes.lat - at.lat) * earth.meridian_radius(at.lat)
    east = wrap_angle(fixes.lon - at.lon) * earth.prime_vertical_radius(at.lat) * torch.cos(at.lat)
    right, forward, _ = drive.lever_arm
    sine, cosine = torch.sin(at.azimuth), torch.cos(at.azimuth)
    if right != 0.0 or forward != 0.0:
        east = east - (right * cosine + forward * sine)
        north = north - (forward * cosine - right * sine)
    there = fixes.has_position > 0.5
    return [
        (torch.where(there, east, torch.nan), fixes.std_e),
        (torch.where(there, north, torch.nan), fixes.std_n),
    ]


def _height_errors(drive: ReferencedDrive) -> tuple[Tensor, Tensor]:
    fixes = drive.fixes
    # a receiver that tells no height is given a deviation of a kilometre
    there = (fixes.has_position > 0.5) & (fixes.std_u < 500.0)
    error = fixes.height - drive.at_fixes.height - drive.lever_arm[2]
    return torch.where(there, error, torch.nan), fixes.std_u


def _velocity_errors(drive: ReferencedDrive) -> list[tuple[Tensor, Tensor]]:
    fixes, at = drive.fixes, drive.at_fixes
    rate = drive.samples.yaw_rate[drive.timing.index.clamp(min=0)]
    there = (fixes.has_velocity > 0.5) & (rate.abs() < STEADY)
    return [
        (torch.where(there, error, torch.nan), fixes.std_v)
        for error in (fixes.v_e - at.v_e, fixes.v_n - at.v_n)
    ]
