"""The error of every pseudorange and range rate, by its parts.

What broadcast models leave of ionosphere and troposphere moves over tens of minutes and grows
towards the horizon, with the obliquity of :mod:`navlearn.gnss.klobuchar` and the mapping of
:mod:`navlearn.gnss.troposphere`; orbit and clock as broadcast move as slowly. Multipath of the
code moves over seconds, slower when the car stands. Thermal noise is white and follows C/N0.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.signal import lfilter

from navlearn.gnss.klobuchar import ionosphere_obliquity
from navlearn.gnss.range_noise import CN0_OF_FIGURES, LOWEST
from navlearn.gnss.troposphere import slant_factor
from navlearn.logs.synthetic.draws import Array, gauss_markov, generator
from navlearn.logs.synthetic.reflections import Reflections
from navlearn.logs.synthetic.satellite_options import SatelliteOptions

SYSTEMATIC_MEMORY = 10
"""Receptions before the present one that the systematic error remembers."""

_DECAY = 3.0


class RangeErrors(NamedTuple):
    """Errors of S satellites at M receptions by their parts, shape (M, S) each.

    Attributes:
        ionosphere: What is left of the ionosphere, m.
        troposphere: What is left of the troposphere, m.
        orbit: Orbit and clock as broadcast, m.
        multipath: Multipath beside the direct signal, m.
        reflection: Detour of a signal that arrives by reflection alone, m.
        thermal: White noise of the code, m.
        systematic: What follows from elevation and C/N0, m.
        rate: Error of the range rate, m/s.
    """

    ionosphere: Array
    troposphere: Array
    orbit: Array
    multipath: Array
    reflection: Array
    thermal: Array
    systematic: Array
    rate: Array

    def range(self) -> Array:
        """Return the error of the pseudorange, m, shape (M, S)."""
        return np.asarray(sum(self[:-1]), dtype=np.float64)


def carrier_to_noise(
    names: tuple[str, ...],
    elevation: Array,
    loss: Array,
    dt: float,
    *,
    options: SatelliteOptions,
    seed: int,
) -> Array:
    """Return C/N0 by elevation, fading and reflection, dB-Hz, shape (M, S).

    Args:
        names: Satellites S.
        elevation: Their elevation, rad, shape (M, S).
        loss: What reflections cost, dB, shape (M, S).
        dt: Time between receptions, s.
        options: Figures.
        seed: Seed of the simulation.
    """
    gain = options.cn0_zenith - options.cn0_horizon
    fading = _processes(
        names, elevation.shape[0], options.fading, options.fading_time, dt, seed, "fading"
    )
    return options.cn0_horizon + gain * np.sin(elevation) + fading - loss


def range_errors(
    names: tuple[str, ...],
    elevation: Array,
    cn0: Array,
    speed: Array,
    reflected: Reflections,
    dt: float,
    *,
    options: SatelliteOptions,
    seed: int,
) -> RangeErrors:
    """Return the errors of all satellites, received or not.

    Args:
        names: Satellites S.
        elevation: Their elevation, rad, shape (M, S).
        cn0: Their C/N0, dB-Hz, shape (M, S).
        speed: Speed of the car, m/s, shape (M,).
        reflected: Which signals are reflected.
        dt: Time between receptions, s.
        options: Figures.
        seed: Seed of the simulation.
    """
    count = elevation.shape[0]
    height = torch.from_numpy(np.maximum(elevation, LOWEST))
    tracking = 10.0 ** ((CN0_OF_FIGURES - cn0) / 20.0)
    rate = tracking * options.rate_thermal * _white(names, count, seed, "rate")
    return RangeErrors(
        ionosphere=_ionosphere(names, count, dt, options, seed)
        * ionosphere_obliquity(height).numpy(),
        troposphere=_process(
            count, options.troposphere, options.troposphere_time, dt, seed, "troposphere"
        )[:, None]
        * slant_factor(height).numpy(),
        orbit=_processes(names, count, options.orbit, options.orbit_time, dt, seed, "orbit"),
        multipath=multipath(names, elevation, speed, dt, options=options, seed=seed),
        reflection=reflected.detour,
        thermal=tracking * options.thermal * _white(names, count, seed, "thermal"),
        systematic=options.systematic * systematic_error(elevation, cn0),
        rate=rate + reflected.rate_share * speed[:, None],
    )


def multipath(
    names: tuple[str, ...],
    elevation: Array,
    speed: Array,
    dt: float,
    *,
    options: SatelliteOptions,
    seed: int,
) -> Array:
    """Return the multipath of the code, m, shape (M, S).

    A Gauss–Markov process whose correlation time and variance fall with speed: a moving antenna
    passes through the pattern of reflections and averages over it.

    Args:
        names: Satellites S.
        elevation: Their elevation, rad, shape (M, S).
        speed: Speed of the car, m/s, shape (M,).
        dt: Time between receptions, s.
        options: Figures.
        seed: Seed of the simulation.
    """
    quick = 1.0 + speed / options.multipath_speed
    decay = np.exp(-dt * quick / options.multipath_time)
    drive = _white(names, elevation.shape[0], seed, "multipath")
    drive[1:] *= np.sqrt(1.0 - decay[1:] ** 2)[:, None]
    for k in range(1, drive.shape[0]):
        drive[k] += decay[k] * drive[k - 1]
    size = options.multipath / np.sin(np.maximum(elevation, LOWEST))
    return drive * size / np.sqrt(quick)[:, None]


def systematic_error(elevation: Array, cn0: Array) -> Array:
    """Return an error that elevation and C/N0 tell, dimensionless, shape (M, S).

    A linear element with memory, then a quadratic, of C/N0, and a line in the sine of elevation:
    0.6 u + 0.3 u² + 0.5 − sin(elevation), u a weighted mean of (C/N0 − 40 dB-Hz) / 5 dB over the
    present reception and the ten before.

    Args:
        elevation: Elevation, rad, shape (M, S).
        cn0: C/N0, dB-Hz, shape (M, S).
    """
    weights = np.exp(-np.arange(SYSTEMATIC_MEMORY + 1) / _DECAY)
    weights /= weights.sum()
    x = (cn0 - 40.0) / 5.0
    before = np.repeat(x[:1], SYSTEMATIC_MEMORY, axis=0)
    u = lfilter(weights, [1.0], np.concatenate((before, x)), axis=0)[SYSTEMATIC_MEMORY:]
    return np.asarray(0.6 * u + 0.3 * u**2 + 0.5 - np.sin(elevation), dtype=np.float64)


def _ionosphere(
    names: tuple[str, ...], count: int, dt: float, options: SatelliteOptions, seed: int
) -> Array:
    std, time, share = options.ionosphere, options.ionosphere_time, options.ionosphere_shared
    shared = _process(count, std, time, dt, seed, "ionosphere")[:, None]
    own = _processes(names, count, std, time, dt, seed, "ionosphere")
    return math.sqrt(share) * shared + math.sqrt(1.0 - share) * own


def _process(count: int, std: float, time: float, dt: float, seed: int, purpose: str) -> Array:
    return gauss_markov(generator(seed, f"ranges/{purpose}"), count, std, time, dt)


def _processes(
    names: tuple[str, ...],
    count: int,
    std: float,
    time: float,
    dt: float,
    seed: int,
    purpose: str,
) -> Array:
    columns = [_process(count, std, time, dt, seed, f"{purpose}/{name}") for name in names]
    return np.stack(columns, axis=1)


def _white(names: tuple[str, ...], count: int, seed: int, purpose: str) -> Array:
    columns = [generator(seed, f"ranges/{purpose}/{name}").standard_normal(count) for name in names]
    return np.stack(columns, axis=1)
