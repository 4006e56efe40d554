"""Where the satellites of a reception stand over the car, by which placement chooses.

Where the car is comes from the track: of satellites 20 000 km away a kilometre turns the direction
by less than 0.01°, so that nothing of the reference's precision is in the choice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch

from navlearn.gnss.sight import sight
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.receptions import receptions_of
from navlearn.outages.schedule import Outage
from navlearn.outages.track import Array, Track, track_of


@dataclass(frozen=True, kw_only=True)
class Sky:
    """The satellites of one reception, S of them, sorted by name.

    Attributes:
        t: Time of the reception, s.
        names: Their names.
        unit: Unit vectors from car to satellite, east, north, up, shape (S, 3).
        elevation: Rad, shape (S,).
        azimuth: Rad, clockwise from north, shape (S,).
    """

    t: float
    names: tuple[str, ...]
    unit: Array
    elevation: Array
    azimuth: Array


def sky_at(ranges: pd.DataFrame, t: float, track: Track) -> Sky:
    """Return where the satellites of a reception stand.

    Args:
        ranges: A log's table of raw ranges.
        t: Time of the reception, s, as it stands in the table.
        track: Tells where the car is.
    """
    seen = ranges[ranges["t"] == t].sort_values("satellite")
    height = np.where(np.isfinite(track.height), track.height, 0.0)
    place = (float(np.interp(t, track.t, values)) for values in (track.lat, track.lon, height))
    lat, lon, up = (torch.tensor(value, dtype=torch.float64) for value in place)
    satellites = torch.tensor(seen[["sat_x", "sat_y", "sat_z"]].to_numpy(dtype=np.float64))
    found = sight(lat, lon, up, satellites)
    return Sky(
        t=t,
        names=tuple(str(name) for name in seen["satellite"]),
        unit=found.unit.numpy(),
        elevation=found.elevation.numpy(),
        azimuth=found.azimuth.numpy(),
    )


def skies_of(log: DriveLog, outages: Sequence[Outage]) -> list[Sky]:
    """Return the sky of the last reception before each outage; none without raw ranges.

    Args:
        log: The whole drive.
        outages: Outages, each with a reception before it.
    """
    if log.ranges is None or log.ranges.empty:
        return []
    received, track = receptions_of(log.ranges), track_of(log)
    last = [received.before(outage.start) for outage in outages]
    return [sky_at(log.ranges, float(received.t[k]), track) for k in last if k is not None]
