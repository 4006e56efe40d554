"""Terms of a gyro-rate error: products of affine forms of what the sensors told.

Every term is a product of a few factors, each an affine form of the channels or its magnitude.
Physics' terms ω, |ω|, ω|ω|, f_x and f_y are such products, so are the candidates of FOS, and so
are the powers of a cascade's linear element. The gyro's bias is taken off the yaw rate first:
the kink of |ω| lies where the car goes straight, not where a biased gyro reads zero.
"""

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError

PHYSICAL_TERMS = ("yaw_rate", "abs_yaw_rate", "yaw_rate*abs_yaw_rate", "f_x", "f_y")
"""Scale factor, asymmetry, quadratic nonlinearity, and g-sensitivity of both level axes."""

PRIOR_SIGMA: Mapping[str, float] = {
    "yaw_rate": 0.03,
    "abs_yaw_rate": 0.009,
    "yaw_rate*abs_yaw_rate": 0.015,
    "f_x": math.radians(0.3) / 9.80665,
    "f_y": math.radians(0.3) / 9.80665,
}
"""How large coefficients are before anything is learned, in SI units: per unit of rate, per
rad/s, and rad/s per m/s²."""

UNITS: Mapping[str, tuple[str, float]] = {
    "yaw_rate": ("%", 100.0),
    "abs_yaw_rate": ("%", 100.0),
    "yaw_rate*abs_yaw_rate": ("% per rad/s", 100.0),
    "f_x": ("deg/s per g", math.degrees(9.80665)),
    "f_y": ("deg/s per g", math.degrees(9.80665)),
}
"""Unit in which a reader knows a coefficient, and what turns SI into it."""

MAGNITUDE = "abs_"


class GyroTerms(NamedTuple):
    """J terms of up to F factors over m channels.

    Attributes:
        names: Name of each term.
        form: Constant and weight of every channel per factor, shape (J, F, m + 1).
        magnitude: 1.0 where the magnitude of the form is taken, shape (J, F).
    """

    names: tuple[str, ...]
    form: Tensor
    magnitude: Tensor


def product_terms(names: tuple[str, ...], inputs: tuple[str, ...], gyro_bias: float) -> GyroTerms:
    """Return terms by their names.

    Args:
        names: Products of one or two factors joined by ``*``; a factor is a channel, or its
            magnitude written ``abs_`` before the channel's name.
        inputs: Channels of the model, in order.
        gyro_bias: What is taken off the yaw rate, rad/s.

    Raises:
        ConfigError: A factor is no channel, or a term has more than two.
    """
    form = torch.zeros(len(names), 2, len(inputs) + 1, dtype=torch.float64)
    magnitude = torch.zeros(len(names), 2, dtype=torch.float64)
    form[:, :, 0] = 1.0
    for row, marks, name in zip(form, magnitude, names, strict=True):
        factors = name.split("*")
        if len(factors) > 2:
            raise ConfigError(f"gyro term {name!r}: found {len(factors)} factors; give one or two")
        for k, factor in enumerate(factors):
            channel = _channel(factor, name, inputs)
            marks[k] = float(factor.startswith(MAGNITUDE))
            row[k, 0] = -gyro_bias if channel == "yaw_rate" else 0.0
            row[k, 1 + inputs.index(channel)] = 1.0
    return GyroTerms(names, form, magnitude)


def channels_of(factors: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels that terms or factors are made of, each once, in order.

    Args:
        factors: Names of terms or factors.
    """
    parts = [part.removeprefix(MAGNITUDE) for name in factors for part in name.split("*")]
    return tuple(dict.fromkeys(parts))


def candidate_names(factors: tuple[str, ...], degree: int) -> tuple[str, ...]:
    """Return the names of all products of factors up to a degree, none twice.

    The square of a magnitude is that of its channel, so it is left out.

    Args:
        factors: Channels and magnitudes.
        degree: 1 or 2.
    """
    names = list(factors)
    if degree == 2:
        for a, b in combinations_with_replacement(factors, 2):
            if not (a == b and a.startswith(MAGNITUDE) and a.removeprefix(MAGNITUDE) in factors):
                names.append(f"{a}*{b}")
    return tuple(names)


def prior_sigmas(
    names: tuple[str, ...], spread: Tensor, priors: Mapping[str, float], other: float
) -> Tensor:
    """Return the standard deviation of each coefficient before anything is learned, SI.

    Args:
        names: Names of the terms.
        spread: Root mean square of each term, shape (J,).
        priors: Deviations of terms that have one of their own.
        other: Rate error that any other term is expected to make at its root mean square, rad/s.

    Returns:
        Shape (J,).
    """
    unknown = other / torch.where(spread > 0.0, spread, 1.0)
    known = [priors.get(name, float(unknown[k])) for k, name in enumerate(names)]
    return torch.tensor(known, dtype=torch.float64)


def _channel(factor: str, name: str, inputs: tuple[str, ...]) -> str:
    channel = factor.removeprefix(MAGNITUDE)
    if channel not in inputs:
        raise ConfigError(
            f"gyro term {name!r}: {channel!r} is none of the model's channels {', '.join(inputs)}"
        )
    return channel
