"""Seeded random draws: one generator per purpose, and the processes that sensors suffer from.

Every purpose has its own generator, spawned from the seed by the purpose's name: a sensor that
is added or left out does not change what another one draws. Processes follow [Groves2013]
§4.4 and the noise terms of IEEE Std 952.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def generator(seed: int, purpose: str) -> np.random.Generator:
    """Return the random generator of one purpose.

    Args:
        seed: Seed of the whole simulation, not negative.
        purpose: Name of what is drawn, such as ``"gyro_z/white"``.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(purpose.encode())))


def white_noise(rng: np.random.Generator, count: int, density: float, dt: float) -> Array:
    """Return interval means of white noise.

    Args:
        rng: Generator to draw from.
        count: Number of samples.
        density: Root spectral density, unit·√s (an angle random walk, rad/√s).
        dt: Length of the averaging interval, s.

    Returns:
        Noise with standard deviation density/√dt, shape (count,).
    """
    return rng.standard_normal(count) * (density / math.sqrt(dt))


def random_walk(rng: np.random.Generator, count: int, density: float, dt: float) -> Array:
    """Return a random walk that starts from zero.

    Args:
        rng: Generator to draw from.
        count: Number of samples.
        density: Growth, unit/√s: the standard deviation after t seconds is density·√t.
        dt: Sampling interval, s.

    Returns:
        The walk after each interval, shape (count,).
    """
    return np.cumsum(rng.standard_normal(count)) * (density * math.sqrt(dt))


def gauss_markov(
    rng: np.random.Generator, count: int, std: float, correlation_time: float, dt: float
) -> Array:
    """Return a stationary first-order Gauss–Markov process.

    x[k] = e^(−dt/τ) x[k−1] + w[k], started from its stationary distribution.

    Args:
        rng: Generator to draw from.
        count: Number of samples.
        std: Stationary standard deviation.
        correlation_time: τ, s.
        dt: Sampling interval, s.

    Returns:
        The process, shape (count,).
    """
    decay = math.exp(-dt / correlation_time)
    drive = rng.standard_normal(count) * (std * math.sqrt(1.0 - decay * decay))
    drive[:1] *= 1.0 / math.sqrt(1.0 - decay * decay)
    return np.asarray(lfilter([1.0], [1.0, -decay], drive), dtype=np.float64)


def smooth_noise(rng: np.random.Generator, count: int, scale: float) -> Array:
    """Return noise of unit variance, smooth over a number of samples.

    Args:
        rng: Generator to draw from.
        count: Number of samples.
        scale: Standard deviation of the Gaussian smoothing kernel, samples.

    Returns:
        Smooth noise, shape (count,).
    """
    half = math.ceil(4.0 * scale)
    coarse = max(1, int(scale / 4.0))
    # A wide kernel is applied on a coarser grid: smooth noise loses nothing by it.
    points = count // coarse + 2
    reach = half // coarse + 1
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * (coarse / scale)) ** 2)
    kernel /= math.sqrt(float(np.sum(kernel**2)))
    values = np.convolve(rng.standard_normal(points + 2 * reach), kernel, mode="valid")
    return np.interp(np.arange(count), np.arange(values.size) * coarse, values)
