"""Delay of the ionosphere as GPS broadcasts it.

Source: [ISGPS200] §20.3.3.5.2.5 and figure 20-4, after [Klobuchar1987]: half of the delay, on
average, is taken off by eight numbers.
"""

import math

import torch
from torch import Tensor

from navlearn.gnss import signals


def klobuchar_delay(
    lat: Tensor,
    lon: Tensor,
    elevation: Tensor,
    azimuth: Tensor,
    gps_seconds: Tensor,
    coefficients: Tensor,
) -> Tensor:
    """Return the delay of a code by the ionosphere on L1.

    Angles are semicircles inside, as the model is broadcast. Below the horizon the delay is that
    on it. Another carrier: :func:`navlearn.gnss.signals.delay_on_carrier`.

    Args:
        lat: Geodetic latitude of the antenna, rad, shape that broadcasts with ``elevation``.
        lon: Longitude of the antenna, rad, shape as ``lat``.
        elevation: Elevation of the satellite, rad, shape (...).
        azimuth: Azimuth of the satellite, rad, shape (...).
        gps_seconds: GPS time of reception, s since 6 January 1980 or of the week, shape that
            broadcasts with ``elevation``.
        coefficients: α₀ to α₃ and β₀ to β₃ as broadcast (s and s per semicircle to the powers
            0 to 3), shape (..., 8).

    Returns:
        Delay on L1, m, taken off a pseudorange, shape (...).
    """
    magnetic, local_time = _pierced(lat, lon, elevation.clamp_min(0.0), azimuth, gps_seconds)
    a0, a1, a2, a3, b0, b1, b2, b3 = coefficients.unbind(-1)
    amplitude = a0 + magnetic * (a1 + magnetic * (a2 + magnetic * a3))
    period = b0 + magnetic * (b1 + magnetic * (b2 + magnetic * b3))
    x = 2.0 * math.pi * (local_time - 50400.0) / period.clamp_min(72000.0)
    bulge = amplitude.clamp_min(0.0) * (1.0 - x**2 / 2.0 + x**4 / 24.0)
    zenith = 5e-9 + torch.where(torch.abs(x) < 1.57, bulge, torch.zeros_like(bulge))
    return signals.SPEED_OF_LIGHT * ionosphere_obliquity(elevation.clamp_min(0.0)) * zenith


def ionosphere_obliquity(elevation: Tensor) -> Tensor:
    """Return how much longer a signal's way through the ionosphere is than from the zenith.

    [ISGPS200] figure 20-4.

    Args:
        elevation: Elevation, not negative, rad, shape (...).

    Returns:
        Factor of one and more, shape (...).
    """
    return 1.0 + 16.0 * (0.53 - elevation / math.pi) ** 3


def _pierced(
    lat: Tensor, lon: Tensor, elevation: Tensor, azimuth: Tensor, gps_seconds: Tensor
) -> tuple[Tensor, Tensor]:
    """Return geomagnetic latitude, semicircles, and local time, s, where the layer is pierced."""
    angle = 0.0137 / (elevation / math.pi + 0.11) - 0.022
    pierced_lat = (lat / math.pi + angle * torch.cos(azimuth)).clamp(-0.416, 0.416)
    pierced_lon = lon / math.pi + angle * torch.sin(azimuth) / torch.cos(pierced_lat * math.pi)
    magnetic = pierced_lat + 0.064 * torch.cos((pierced_lon - 1.617) * math.pi)
    return magnetic, torch.remainder(43200.0 * pierced_lon + gps_seconds, 86400.0)
