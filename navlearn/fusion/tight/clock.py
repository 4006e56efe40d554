"""The receiver's clock: bias, drift, and one offset for each further system.

Two states driven by white frequency noise and by a random walk of the frequency [Groves2013]
§14.2.6; discretised exactly. All are times multiplied by the speed of light.
"""

import torch
from torch import Tensor

from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.options import ClockOptions

BIAS = 0
"""Place of the bias among the clock states."""

DRIFT = 1
"""Place of the drift."""


def clock_names(systems: int) -> tuple[str, ...]:
    """Return the names of the clock states.

    Args:
        systems: Number of satellite systems.
    """
    further = (f"system_offset_{j}" for j in range(1, systems))
    return ("clock_bias", "clock_drift", *further)


def advanced_clock(clock: Tensor, dt: Tensor) -> Tensor:
    """Return the clock states after an interval: the bias follows the drift.

    Args:
        clock: Bias, drift, offsets, m and m/s, shape (..., c).
        dt: Length of the interval, s, shape (...).

    Returns:
        Shape (..., c).
    """
    bias, rest = clock[..., :1], clock[..., 1:]
    return torch.cat((bias + rest[..., :1] * dt.unsqueeze(-1), rest), -1)


def clock_transition(dt: Tensor, systems: int) -> Tensor:
    """Return Φ of the clock states.

    Args:
        dt: Length of the interval, s, shape (...).
        systems: Number of satellite systems.

    Returns:
        Shape (..., c, c).
    """
    count = len(clock_names(systems))
    unit = torch.eye(count, dtype=dt.dtype, device=dt.device)
    coupling = torch.zeros_like(unit)
    coupling[BIAS, DRIFT] = 1.0
    return unit + dt[..., None, None] * coupling


def clock_noise(dt: Tensor, systems: int, noise: TightNoise) -> Tensor:
    """Return Q of the clock states, exact for any interval.

    Args:
        dt: Length of the interval, s, shape (...).
        systems: Number of satellite systems.
        noise: Densities.

    Returns:
        Shape (..., c, c).
    """
    white, walk = noise.frequency_noise**2, noise.frequency_walk**2
    bias = white * dt + walk * dt**3 / 3.0
    both = 0.5 * walk * dt * dt
    core = torch.stack((bias, both, both, walk * dt), -1).reshape(*dt.shape, 2, 2)
    further = systems - 1
    offsets = (noise.offset_walk**2 * dt).unsqueeze(-1).expand(*dt.shape, further)
    wide = torch.nn.functional.pad(core, (0, further, 0, further))
    return wide + torch.nn.functional.pad(torch.diag_embed(offsets), (2, 0, 2, 0))


def initial_clock_variance(options: ClockOptions, systems: int, like: Tensor) -> Tensor:
    """Return the variances of the clock states before the first range.

    Args:
        options: The clock.
        systems: Number of satellite systems.
        like: Any tensor of the dtype and device wanted.

    Returns:
        Shape (c,).
    """
    further = [options.initial_offset] * (systems - 1)
    return like.new_tensor([options.initial_bias, options.initial_drift, *further]) ** 2
