"""Noise densities of a RISS filter from the increments of dead reckoning's error.

The rule ``increments``: [Ghouneem2024] takes Q from reference minus RISS, and as printed takes
averages of it; a density is the mean square of an increment over its length. What a state of the
filter explains (a gyro bias, a scale factor) is taken off first, or it would count twice.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.options import EkfOptions
from navlearn.learning.increment_statistics import (
    fitted,
    random_walk,
    sums_over,
    white_density,
    window_values,
)
from navlearn.learning.reference_increments import Increments

SLOW = 60.0
"""Windows in which a slow error counts as constant, s."""

LASTING = 10.0
"""How long a turn or a hill lasts: what is wrong in it is wrong throughout, s."""

STRAIGHT = 0.02
"""Root mean square yaw rate up to which a stretch is straight, rad/s."""


class FoundNoise(NamedTuple):
    """What increments tell of a filter's options.

    Attributes:
        noise: Entries of :class:`navlearn.fusion.noise_options.NoiseOptions` by name.
        parameters: Sensor parameters that a filter starts with at zero, by the names of
            :class:`navlearn.fusion.error_state.ErrorLayout`; in size.
    """

    noise: dict[str, float]
    parameters: dict[str, float]


def increment_noise(increments: Increments, options: EkfOptions) -> FoundNoise:
    """Return noise densities that increments of dead reckoning's error show.

    Args:
        increments: Of one drive.
        options: The filter. What it has no state for is part of the noise.
    """
    parts = [_of_azimuth(increments, options), _of_position(increments, options)]
    parts.append(_of_height(increments, options))
    if options.has_velocity_states:
        parts.append(_of_velocity(increments))
    return FoundNoise(
        {name: value for part in parts for name, value in part.noise.items()},
        {name: value for part in parts for name, value in part.parameters.items()},
    )


def over_drives(found: list[FoundNoise], stretches: list[int]) -> dict[str, float]:
    """Return noise densities of several drives as those of one.

    Args:
        found: What each drive told.
        stretches: How many stretches it told it with.

    Returns:
        Root mean squares by name, weighted by stretches, over the drives that tell them.
    """
    named: dict[str, float] = {}
    for name in dict.fromkeys(name for one in found for name in one.noise):
        told = [
            (one.noise[name], n)
            for one, n in zip(found, stretches, strict=True)
            if name in one.noise
        ]
        named[name] = math.sqrt(sum(n * value**2 for value, n in told) / sum(n for _, n in told))
    return named


def _of_azimuth(found: Increments, options: EkfOptions) -> FoundNoise:
    """Mean squares: gyro_random_walk² + (turn_noise · ω)²; from minute to minute gyro_bias_walk².

    A scale factor is wrong all through a turn, so turn_noise is told by stretches as long as one.
    """
    span, place, size = found.span, found.place, round(SLOW / found.span)
    error, parameters = found.azimuth, dict[str, float]()
    terms = options.gyro_states
    for term, value, by in _without_bias(found, terms, size):
        error = error - value * by
        parameters[f"gyro_{term}"] = abs(value)
    biased = "bias" in terms
    straight = found.turned_squared < STRAIGHT**2 * span
    calm = straight if int(straight.sum()) > len(straight) // 10 else torch.ones_like(straight)
    white = white_density(error[calm], place[calm], span, drifting=biased)
    noise = {"gyro_random_walk": white**0.5}
    turning, rest = options.noise.turn_noise**2, error
    if biased:
        unit = torch.full_like(error, span)
        variance = white * span + turning * found.turned_squared
        bias = window_values(error, unit, variance, place, size)
        rest = error - span * bias.value[bias.of]
    turning = _turning(rest, found, white)
    noise["turn_noise"] = turning**0.5
    if biased:
        variance = white * span + turning * found.turned_squared
        walk = random_walk(window_values(error, unit, variance, place, size), size * span)
        noise.update(_named("gyro_bias_walk", walk))
    return FoundNoise(noise, parameters)


def _without_bias(
    found: Increments, terms: tuple[str, ...], size: int
) -> list[tuple[str, float, Tensor]]:
    """Return name, value and regressor of every gyro parameter but the bias."""
    names = [term for term in terms if term != "bias"]
    columns = [found.by_gyro[:, terms.index(term)] for term in names]
    if not columns:
        return []
    place = found.place if "bias" in terms else None
    values = fitted(found.azimuth, torch.stack(columns, -1), place, size)
    return list(zip(names, values.tolist(), columns, strict=True))


def _turning(error: Tensor, found: Increments, white: float) -> float:
    """Return what turning adds, s: mean square beyond white noise over the squared rate."""
    size = max(round(LASTING / found.span), 1)
    sums = sums_over(error, found.place, size)
    turned = sums_over(found.turned_squared, found.place, size)
    if len(sums) < 2:
        sums, turned, size = error, found.turned_squared, 1
    beyond = sums * sums - white * size * found.span
    deviation = float(beyond.std()) * math.sqrt(len(sums))
    return max(float(beyond.sum()), deviation) / float(turned.sum())


def _of_position(found: Increments, options: EkfOptions) -> FoundNoise:
    """Mean squares along and across, halved: position_walk²."""
    size = round(SLOW / found.span)
    terms = options.speed_states
    values = fitted(found.along, found.by_speed)
    along = found.along - found.by_speed @ values
    # a reference whose axes are turned a little against the car's drives sideways
    across = found.across - found.way * fitted(found.across, found.way[:, None])
    white = 0.5 * float((along.square() + across.square()).mean()) / found.span
    noise = {"position_walk": white**0.5}
    parameters = {
        f"speed_{term}": abs(value) for term, value in zip(terms, values.tolist(), strict=True)
    }
    scale = values[terms.index("scale")] if "scale" in terms else values.new_zeros(())
    if "scale" in terms:
        variance = torch.full_like(along, white * found.span)
        walk = random_walk(
            window_values(along, found.way, variance, found.place, size), size * found.span
        )
        noise.update(_named("speed_scale_walk", walk))
    speed = found.speed_along - scale * found.way / found.span
    known = speed.isfinite()
    if bool(known.any()):
        noise["speed_noise"] = float(speed[known].square().mean().sqrt())
    return FoundNoise(noise, parameters)


def _of_height(found: Increments, options: EkfOptions) -> FoundNoise:
    """Mean squares upwards: height_walk², in 2D over ten seconds and named hill_walk²."""
    known = found.up.isfinite()
    if not bool(known.any()):
        return FoundNoise({}, {})
    up, way, place = found.up[known], found.way[known], found.place[known]
    if not options.mechanization.three_d:
        size = max(round(LASTING / found.span), 1)
        sums = sums_over(up, place, size)
        rise, length = (sums, size * found.span) if len(sums) > 1 else (up, found.span)
        return FoundNoise({"hill_walk": float((rise.square().mean() / length).sqrt())}, {})
    if not options.has_pitch_state:
        return FoundNoise(
            {"height_walk": white_density(up, place, found.span, drifting=False) ** 0.5}, {}
        )
    size = round(SLOW / found.span)
    pitch = window_values(up, way, torch.ones_like(up), place, size)
    rest = up - way * pitch.value[pitch.of]
    white = float(rest.square().mean()) / found.span
    variance = torch.full_like(up, white * found.span)
    walk = random_walk(window_values(up, way, variance, place, size), size * found.span)
    noise = {"height_walk": white**0.5, **_named("pitch_bias_walk", walk)}
    return FoundNoise(noise, {"pitch_bias": abs(float((up * way).sum() / (way * way).sum()))})


def _of_velocity(found: Increments) -> FoundNoise:
    """Mean squares of the change of the velocity's error: velocity_walk²."""
    neighbours = torch.diff(found.place) == 1
    axes = torch.stack((found.speed_along, found.speed_across, found.speed_up))
    changes = torch.diff(axes, dim=-1)[:, neighbours]
    squares = [axis[axis.isfinite()].square().mean() for axis in changes if axis.isfinite().any()]
    if not squares:
        return FoundNoise({}, {})
    return FoundNoise(
        {"velocity_walk": float((sum(squares) / len(squares) / found.span) ** 0.5)}, {}
    )


def _named(name: str, value: float | None) -> dict[str, float]:
    return {} if value is None else {name: value}
