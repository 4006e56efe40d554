"""From positions in local metres to latitude, longitude and height, about a stated origin.

A log that was published without its place needs one for the Earth's rotation, curvature and
gravity. A few kilometres of mistake in it change none of them noticeably; shape and length of
the track do not depend on it.
"""

import math
from typing import Final

import numpy as np
import pandas as pd
import torch

from navlearn import wgs84
from navlearn.errors import LogError
from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix, geodetic_from_ecef
from navlearn.logs.interval_means import FloatArray
from navlearn.logs.table_layout import Origin

LOCAL: Final = ("east", "north", "up")
"""Columns that a table may have in place of ``lat``, ``lon`` and ``height``, m."""

Geodetic = tuple[FloatArray, FloatArray, FloatArray]


def geodetic_table(where: str, table: pd.DataFrame, origin: Origin | None) -> pd.DataFrame:
    """Return a table with its local positions replaced by geodetic ones.

    Velocities and angles are taken to be those of the place itself, as they stand.

    Args:
        where: Name of the table in messages.
        table: Table, with or without local positions.
        origin: Where they begin.

    Raises:
        LogError: There are local positions and no origin, or one of east and north is missing.
    """
    present = [name for name in LOCAL if name in table]
    if not present:
        return table
    if origin is None or not {"east", "north"} <= set(present):
        found, needed = ", ".join(present), "east and north (up is optional)"
        raise LogError(
            f"{where}: local positions ({found}) need {needed} and an origin in the descriptor, "
            "such as origin: {lat_deg: 49.0, lon_deg: 8.4, height: 0.0}"
        )
    east, north = (table[name].to_numpy(np.float64) for name in ("east", "north"))
    up = table["up"].to_numpy(np.float64) if "up" in table else np.zeros(east.size)
    transform = from_mercator if origin.plane == "mercator" else from_tangent_plane
    lat, lon, height = transform(east, north, up, origin)
    places = {"lat": lat, "lon": lon} | ({"height": height} if "up" in table else {})
    return table.drop(columns=present).assign(**places)


def from_tangent_plane(
    east: FloatArray, north: FloatArray, up: FloatArray, origin: Origin
) -> Geodetic:
    """Return latitude (rad), longitude (rad) and height (m) of points on a tangent plane.

    [Groves2013] Eq. (2.112), (2.113) and (2.150).

    Args:
        east: Along the plane to the east at the origin, m, shape (N,).
        north: To the north, m, shape (N,).
        up: Above the plane, m, shape (N,).
        origin: Where the plane touches.
    """
    start = [torch.tensor(x, dtype=torch.float64) for x in _radians(origin)]
    enu = torch.from_numpy(np.stack((east, north, up), axis=-1))
    turn = enu_from_ecef_matrix(start[0], start[1])
    places = geodetic_from_ecef(ecef_from_geodetic(*start) + enu @ turn)
    lat, lon, height = (x.numpy() for x in places)
    return lat, lon, height


def from_mercator(east: FloatArray, north: FloatArray, up: FloatArray, origin: Origin) -> Geodetic:
    """Return latitude (rad), longitude (rad) and height (m) of points on a Mercator map.

    The map takes the Earth for a sphere of the ellipsoid's major axis and is scaled by the
    cosine of the origin's latitude, as the KITTI development kit does. Its metres differ from
    those on the ellipsoid (at 49°: 0.19 % east, 0.10 % north); undoing the map undoes that.

    Args:
        east: Map distance to the east, m, shape (N,).
        north: Map distance to the north, m, shape (N,).
        up: Difference of height, m, shape (N,).
        origin: Zero point of the map.
    """
    lat_0, lon_0, height_0 = _radians(origin)
    scale = wgs84.SEMI_MAJOR_AXIS * math.cos(lat_0)
    stretched = math.asinh(math.tan(lat_0)) + north / scale
    return np.arctan(np.sinh(stretched)), lon_0 + east / scale, height_0 + up


def _radians(origin: Origin) -> tuple[float, float, float]:
    return math.radians(origin.lat_deg), math.radians(origin.lon_deg), origin.height
