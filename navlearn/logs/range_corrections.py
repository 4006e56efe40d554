"""What the broadcast tells of ranges, taken off where a log has not done so already.

Each correction is one of: done in the log, by a column of it, by a model, or by nothing.
"""

from typing import Final, NamedTuple

import torch
from torch import Tensor

from navlearn import frames
from navlearn.gnss import signals
from navlearn.gnss.earth_rotation import in_axes_of_reception
from navlearn.gnss.klobuchar import klobuchar_delay
from navlearn.gnss.sight import Sight
from navlearn.gnss.troposphere import saastamoinen_delay
from navlearn.logs.drive_log import LogMetadata

CARRIERS: Final = {"R": signals.G1, "C": signals.B1I}
"""Carrier by constellation where it is not L1, Hz: GLONASS in the middle of its channels."""

IN_LOG: Final = "in the log"
"""How a correction is named that a log has in its values."""


class Delays(NamedTuple):
    """Delays of ranges and where they are from.

    Attributes:
        ionosphere: Metres to take off, shape (M, S).
        troposphere: The same.
        sources: ``ionosphere`` and ``troposphere``, each ``in the log``, ``column``,
            ``klobuchar`` or ``saastamoinen``, or ``none``.
    """

    ionosphere: Tensor
    troposphere: Tensor
    sources: dict[str, str]


def turned_to_reception(
    satellite: Tensor, velocity: Tensor, lat: Tensor, lon: Tensor, height: Tensor
) -> tuple[Tensor, Tensor]:
    """Return satellites and velocities in Earth-fixed axes of the moment of reception.

    How long the signal travelled follows from the distance, whatever the receiver's clock says.

    Args:
        satellite: Satellites in axes of the moment of sending, m, shape (M, S, 3).
        velocity: Their velocities, m/s, shape (M, S, 3).
        lat: Latitude of the receiver to a few kilometres, rad, shape (M,).
        lon: Its longitude, rad, shape (M,).
        height: Its height, m, shape (M,).
    """
    receiver = frames.ecef_from_geodetic(lat, lon, height).unsqueeze(-2)
    turned = satellite
    for _ in range(2):  # the second time to a micrometre
        travel = torch.linalg.vector_norm(turned - receiver, dim=-1) / signals.SPEED_OF_LIGHT
        turned = in_axes_of_reception(satellite, travel)
    return turned, in_axes_of_reception(velocity, travel)


def delays(
    columns: dict[str, Tensor],
    metadata: LogMetadata,
    t: Tensor,
    place: tuple[Tensor, Tensor, Tensor],
    seen: Sight,
    constellations: tuple[str, ...],
) -> Delays:
    """Return what ionosphere and troposphere add to ranges and the log has not taken off.

    A column counts where it has a value, a model elsewhere: Klobuchar where its coefficients and
    the GPS time are known, Saastamoinen in a standard atmosphere.

    Args:
        columns: ``ionosphere`` and ``troposphere`` where the log has them, NaN where unknown,
            shape (M, S) each.
        metadata: Corrections already done, Klobuchar's coefficients, GPS time of t = 0.
        t: Times of reception, s, shape (M,).
        place: Latitude, longitude (rad) and height (m) of the receiver, shape (M,) each.
        seen: The satellites as seen from there.
        constellations: RINEX letter of each satellite, S of them.
    """
    lat, lon, height = (part.unsqueeze(-1) for part in place)
    sources = {}
    modelled: dict[str, Tensor | None] = {
        "ionosphere": _klobuchar(metadata, t, lat, lon, seen, constellations),
        "troposphere": saastamoinen_delay(lat, height, seen.elevation),
    }
    names = {"ionosphere": "klobuchar", "troposphere": "saastamoinen"}
    total = {}
    for name, model in modelled.items():
        told = columns.get(name)
        total[name] = torch.zeros_like(seen.elevation)
        if name in metadata.range_corrections:
            sources[name] = IN_LOG
            continue
        sources[name] = "none"
        if model is not None:
            total[name], sources[name] = model, names[name]
        if told is not None and bool(told.isfinite().any()):
            total[name], sources[name] = torch.where(told.isfinite(), told, total[name]), "column"
    return Delays(total["ionosphere"], total["troposphere"], sources)


def _klobuchar(
    metadata: LogMetadata,
    t: Tensor,
    lat: Tensor,
    lon: Tensor,
    seen: Sight,
    constellations: tuple[str, ...],
) -> Tensor | None:
    if len(metadata.klobuchar) != 8 or metadata.gps_time_origin is None:
        return None
    seconds = (t + metadata.gps_time_origin).unsqueeze(-1)
    told = torch.tensor(metadata.klobuchar, dtype=torch.float64)
    delay = klobuchar_delay(lat, lon, seen.elevation, seen.azimuth, seconds, told)
    carriers = [CARRIERS.get(letter, signals.L1) for letter in constellations]
    return signals.delay_on_carrier(delay, torch.tensor(carriers, dtype=torch.float64))
