"""How noisy a pseudorange and a range rate are: by elevation, C/N0 and what the receiver tells.

The variance of a pseudorange is a sum of independent parts, as the error budgets of
[Groves2013] §9.3 and [RTCA2016] §J.2.4 have it: orbit and clock as broadcast, what Klobuchar's
model leaves of the ionosphere with its obliquity [ISGPS200] Fig. 20-4, what a model leaves of the
troposphere with the mapping of [RTCA2016] §A.4.2.4, the thermal noise of tracking by C/N0
[Hartinger1999], and multipath that grows as 1 / sin(elevation). A receiver's own deviation
stands for thermal noise where it is told: receivers know their tracking loops, not the street.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.gnss.klobuchar import ionosphere_obliquity
from navlearn.gnss.troposphere import slant_factor

CN0_OF_FIGURES = 45.0
"""C/N0 at which the options state thermal noise, dB-Hz: an open sky."""

LOWEST = math.radians(5.0)
"""Below this elevation the models hold no longer, and nothing grows any further, rad."""


SHORTEST = 0.01
"""Receptions are never taken to follow each other faster, s."""


@dataclass(frozen=True, kw_only=True)
class RangeNoiseOptions:
    """Parts of the error of one pseudorange and one range rate; deviations.

    The defaults suit a low-cost single-frequency receiver in a town, with broadcast orbits,
    Klobuchar's ionosphere and a standard troposphere. They are round figures of the sources
    above, fitted to no drive. What is zero is left out.

    Attributes:
        orbit_clock: Orbit and clock as broadcast, m.
        ionosphere: What a model leaves of the delay at the zenith, m; grows 3 times at 5°.
        troposphere: The same of the troposphere, m; grows 10 times at 5°.
        multipath: Multipath at the zenith, m; grows as 1 / sin(elevation).
        multipath_time: How long multipath stays alike, s: to a filter that hears a satellite more
            often, each time counts for less.
        thermal: Tracking noise of the code at 45 dB-Hz, m; doubles for every 6 dB less.
        told_factor: Factor on the deviation that the receiver tells of its pseudorange, which
            then stands for ``thermal``.
        rate_floor: Of a range rate: clocks, orbits and the car's own jerk, m/s.
        rate_multipath: Of a range rate at the zenith, m/s; grows as 1 / sin(elevation).
        rate_thermal: Tracking noise of the carrier's frequency at 45 dB-Hz, m/s; doubles for
            every 6 dB less.
        rate_told_factor: Factor on the deviation that the receiver tells of its range rate,
            which then stands for ``rate_thermal``.
    """

    orbit_clock: float = 1.0
    ionosphere: float = 1.5
    troposphere: float = 0.12
    multipath: float = 1.0
    multipath_time: float = 5.0
    thermal: float = 0.5
    told_factor: float = 1.0
    rate_floor: float = 0.05
    rate_multipath: float = 0.05
    rate_thermal: float = 0.05
    rate_told_factor: float = 1.0

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ConfigError(
                    f"range noise: {entry.name} is {value!r}; expected a finite figure of zero "
                    "or more"
                )


class RangeNoise(NamedTuple):
    """The entries of :class:`RangeNoiseOptions`, one tensor of shape () each.

    Meaning and units are told there.
    """

    orbit_clock: Tensor
    ionosphere: Tensor
    troposphere: Tensor
    multipath: Tensor
    multipath_time: Tensor
    thermal: Tensor
    told_factor: Tensor
    rate_floor: Tensor
    rate_multipath: Tensor
    rate_thermal: Tensor
    rate_told_factor: Tensor


def range_noise(options: RangeNoiseOptions) -> RangeNoise:
    """Return the noise entries as tensors.

    Args:
        options: Deviations.
    """
    values = [getattr(options, name) for name in RangeNoise._fields]
    return RangeNoise(*torch.tensor(values, dtype=torch.float64).unbind(-1))


def log_range_noise(options: RangeNoiseOptions) -> Tensor:
    """Return the logarithms of all noise entries, what an optimiser moves.

    Args:
        options: Deviations.

    Returns:
        Logarithms in the order of :class:`RangeNoise`, −inf for zero, shape (11,).
    """
    return torch.log(torch.stack(tuple(range_noise(options))))


def range_noise_from_log(log: Tensor) -> RangeNoise:
    """Return the noise entries of their logarithms.

    Args:
        log: As :func:`log_range_noise` returns, shape (11,).
    """
    return RangeNoise(*torch.exp(log).unbind(-1))


def range_variance(
    noise: RangeNoise,
    elevation: Tensor,
    cn0: Tensor,
    std_told: Tensor,
    since: Tensor | None = None,
) -> Tensor:
    """Return the variance of pseudoranges, by themselves or as one of many.

    A filter takes its measurements for independent. An error of correlation time τ met every Δt
    seconds tells as much of its mean as independent ones of 2 τ/Δt times its variance (its
    autocorrelation exp(−|t|/τ), integrated), which is what multipath gets where ``since`` is told.

    Args:
        noise: Noise entries.
        elevation: Elevation of the satellite, rad, shape (...).
        cn0: Carrier-to-noise density, dB-Hz, shape (...).
        std_told: Deviation that the receiver tells, m; 0 where it tells none; shape (...).
        since: Time since the reception before, s, shape (...); None for a reception by itself.

    Returns:
        Variance, m², shape (...).
    """
    height = elevation.clamp_min(LOWEST)
    sine = torch.sin(height)
    ionosphere = noise.ionosphere * ionosphere_obliquity(height)
    troposphere = noise.troposphere * slant_factor(height)
    tracking = _tracking(noise.thermal, noise.told_factor, cn0, std_told)
    multipath = (noise.multipath / sine) ** 2
    if since is not None:
        alike = 2.0 * noise.multipath_time / since.clamp_min(SHORTEST)
        multipath = multipath * alike.clamp_min(1.0)
    return noise.orbit_clock**2 + ionosphere**2 + troposphere**2 + multipath + tracking


def rate_variance(noise: RangeNoise, elevation: Tensor, cn0: Tensor, std_told: Tensor) -> Tensor:
    """Return the variance of range rates.

    Args:
        noise: Noise entries.
        elevation: Elevation of the satellite, rad, shape (...).
        cn0: Carrier-to-noise density, dB-Hz, shape (...).
        std_told: Deviation that the receiver tells, m/s; 0 where it tells none; shape (...).

    Returns:
        Variance, m²/s², shape (...).
    """
    sine = torch.sin(elevation.clamp_min(LOWEST))
    tracking = _tracking(noise.rate_thermal, noise.rate_told_factor, cn0, std_told)
    return noise.rate_floor**2 + (noise.rate_multipath / sine) ** 2 + tracking


def _tracking(thermal: Tensor, told_factor: Tensor, cn0: Tensor, std_told: Tensor) -> Tensor:
    by_cn0 = thermal**2 * 10.0 ** (0.1 * (CN0_OF_FIGURES - cn0))
    return torch.where(std_told > 0.0, (told_factor * std_told) ** 2, by_cn0)
