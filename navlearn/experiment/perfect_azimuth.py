"""Dead reckoning along an azimuth that is known: only the odometer can be wrong."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from navlearn import earth
from navlearn.filters.belief import Belief
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.sensor_errors import (
    corrected_motion,
    decay_over,
    odometer_acceleration,
    sensor_errors,
)
from navlearn.outages.track import Array, Track
from navlearn.states import RissSample, Trajectory


@dataclass(frozen=True, kw_only=True)
class KnownAzimuth:
    """Azimuth over a drive, shape (K,) each.

    Attributes:
        t: Time, s, increasing.
        azimuth: Azimuth, rad, not wrapped, finite.
    """

    t: Array
    azimuth: Array

    def at(self, t: Array) -> Array:
        """Return the azimuth at some times, held where it is not known, rad.

        Args:
            t: Times, s, shape (T,).
        """
        return np.asarray(np.interp(t, self.t, self.azimuth), dtype=np.float64)


def known_azimuth(track: Track) -> KnownAzimuth | None:
    """Return the azimuth that a track tells, or None where it tells none.

    Args:
        track: The reference of a drive; its course stands in where it has no azimuth.
    """
    known = np.isfinite(track.azimuth)
    if not known.any():
        return None
    return KnownAzimuth(t=track.t[known], azimuth=track.azimuth[known])


def reckoned(
    options: EkfOptions, belief: Belief, samples: RissSample, azimuth: Tensor
) -> Trajectory:
    """Return the way that a corrected odometer tells along a known azimuth.

    Args:
        options: The filter whose sensor parameters correct the odometer.
        belief: Where to start, no batch axes.
        samples: Intervals, shape (T,) each.
        azimuth: In the middle of each interval, rad, shape (T,).

    Returns:
        Trajectory, shape (T,) each; its azimuth is that at the end of each interval.
    """
    errors = sensor_errors(options)
    motion = corrected_motion(
        errors,
        samples,
        odometer_acceleration(samples.dt, samples.speed),
        belief.sensor.unsqueeze(-2),
        belief.anchor.unsqueeze(-2),
        decay_over(errors, torch.cumsum(samples.dt, -1)),
    )
    v_e, v_n = motion.v_h * torch.sin(azimuth), motion.v_h * torch.cos(azimuth)
    start = belief.state
    height = start.height + torch.cumsum(motion.v_u * motion.dt, -1)
    lat = start.lat + torch.cumsum(
        v_n * motion.dt / (earth.meridian_radius(start.lat) + start.height), -1
    )
    middle = torch.cat((start.lat.unsqueeze(-1), lat[:-1])) + lat
    radius = (earth.prime_vertical_radius(0.5 * middle) + height) * torch.cos(0.5 * middle)
    lon = start.lon + torch.cumsum(v_e * motion.dt / radius, -1)
    following = torch.cat((azimuth[1:], azimuth[-1:]))
    return Trajectory(lat, lon, height, 0.5 * (azimuth + following), v_e, v_n, motion.v_u)
