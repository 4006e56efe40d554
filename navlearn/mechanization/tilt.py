"""Pitch and roll of a car from two accelerometers, its odometer and its yaw gyro.

[Shen2010] Eq. (4): specific force less what the odometer and the gyro say the car accelerates.
The differentiated odometer is noisy and quantised, so the differences pass a causal low-pass; as
they are taken before it, force and acceleration are delayed alike.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.mechanization.low_pass import low_pass_over_time


@dataclass(frozen=True, kw_only=True)
class TiltOptions:
    """Choices of the tilt estimate.

    On the Kingston drive (10 Hz, moving faster than 5 m/s) the defaults leave 0.41° of pitch and
    0.50° of roll against the reference, ``static`` 2.3° and 1.7°; half or double the time constant
    lose no more than 0.06° (``pytest tests/mechanization/test_tilt_kingston.py``).

    Attributes:
        method: ``shen2010`` takes the car's acceleration off the specific force; ``static`` does
            not: gravity alone, as [Ghouneem2024] Eq. (1), with this package's signs and the
            vertical force taken from gravity.
        time_constant: Time constant of each section of the low-pass, s; zero passes all.
        sections: Number of first-order sections.
    """

    method: Literal["shen2010", "static"] = "shen2010"
    time_constant: float = 1.5
    sections: int = 1

    def __post_init__(self) -> None:
        """Refuse what no filter can do.

        Raises:
            ConfigError: If an option lies outside its range.
        """
        if self.method not in ("shen2010", "static"):
            raise ConfigError(
                f"TiltOptions.method: found {self.method!r}; choose 'shen2010' or 'static'"
            )
        if not (math.isfinite(self.time_constant) and self.time_constant >= 0.0):
            raise ConfigError(
                f"TiltOptions.time_constant: found {self.time_constant}; expected 0 s or more"
            )
        if self.sections < 1:
            raise ConfigError(f"TiltOptions.sections: found {self.sections}; expected 1 or more")


class Tilt(NamedTuple):
    """Pitch and roll, and where the force was too large for them; shape (...) or (..., T) each.

    Attributes:
        pitch: Pitch, rad, nose up positive.
        roll: Roll, rad, right side down positive.
        clamped: 1.0 where |sin| of either would exceed 1 and was clamped, else 0.0.
    """

    pitch: Tensor
    roll: Tensor
    clamped: Tensor


def tilt_angles(forward: Tensor, transversal: Tensor, gravity: Tensor) -> Tilt:
    """Return the tilt that gravity's components along the body axes tell.

    [Shen2010] Eq. (4).

    Args:
        forward: γ sin p, m/s², shape (...).
        transversal: −γ cos p sin r, m/s², shape (...).
        gravity: Normal gravity γ, m/s², shape (...).

    Returns:
        Tilt, shape (...) each.
    """
    # a hair below 1, where the slope of asin is finite and clamping cuts the gradient to zero
    limit = 1.0 - 1e-12
    sin_pitch = forward / gravity
    pitch = torch.asin(sin_pitch.clamp(-limit, limit))
    sin_roll = -transversal / (gravity * torch.cos(pitch))
    roll = torch.asin(sin_roll.clamp(-limit, limit))
    clamped = (sin_pitch.abs() > 1.0) | (sin_roll.abs() > 1.0)
    return Tilt(pitch, roll, clamped.to(forward.dtype))


def tilt_from_specific_force(
    f_y: Tensor,
    f_x: Tensor,
    speed: Tensor,
    yaw_rate: Tensor,
    dt: Tensor,
    gravity: Tensor,
    options: TiltOptions | None = None,
) -> Tilt:
    """Return the tilt over a record, all samples at once.

    Equals :class:`navlearn.mechanization.tilt_filter.TiltFilter` sample by sample.

    Args:
        f_y: Mean forward specific force, m/s², shape (..., T).
        f_x: Mean transversal specific force, m/s², shape (..., T).
        speed: Mean odometer speed, m/s, shape (..., T).
        yaw_rate: Mean yaw rate, rad/s, left turn positive, shape (..., T).
        dt: Length of the intervals, s, shape (..., T); zero at the end of a record is padding.
        gravity: Normal gravity, m/s², broadcastable to (..., T).
        options: Choices; None means the defaults.

    Returns:
        Tilt, shape (..., T) each; ``clamped.sum(-1)`` counts.
    """
    options = options or TiltOptions()
    forward, transversal = f_y, f_x
    if options.method == "shen2010":
        forward = _neighbour_mean(f_y) - _difference(speed, dt)
        transversal = _neighbour_mean(f_x + speed * yaw_rate)
    tau, n = options.time_constant, options.sections
    return tilt_angles(
        low_pass_over_time(forward, dt, tau, n),
        low_pass_over_time(transversal, dt, tau, n),
        gravity,
    )


def _neighbour_mean(values: Tensor) -> Tensor:
    """Return means of neighbours: delayed by half an interval, as a difference is."""
    return torch.cat((values[..., :1], 0.5 * (values[..., 1:] + values[..., :-1])), -1)


def _difference(speed: Tensor, dt: Tensor) -> Tensor:
    between = 0.5 * (dt[..., 1:] + dt[..., :-1])
    between = torch.where(between > 0.0, between, torch.ones_like(between))
    change = (speed[..., 1:] - speed[..., :-1]) / between
    return torch.cat((torch.zeros_like(speed[..., :1]), change), -1)
