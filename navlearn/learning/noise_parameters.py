"""Which entries of a filter's noise are free to be tuned, and what a vector of them means.

The vector holds natural logarithms, so that a step is a factor and nothing turns negative.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import ERROR_UNITS, error_layout
from navlearn.fusion.measurements import Kind, measurement_rows
from navlearn.fusion.noise import EkfNoise, log_noise, noise_from_log
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions

UNITS: Final[dict[str, str]] = {
    "gyro_random_walk": "rad/√s",
    "turn_noise": "√s",
    "gyro_bias_walk": "rad/s/√s",
    "speed_scale_walk": "1/√s",
    "pitch_bias_walk": "rad/√s",
    **dict.fromkeys(("position_walk", "height_walk", "hill_walk"), "m/√s"),
    "velocity_walk": "m/s/√s",
    "acceleration_walk": "m/s²/√s",
    **dict.fromkeys(("position_floor", "height_floor"), "m"),
    **dict.fromkeys(("velocity_floor", "speed_noise", "zero_speed"), "m/s"),
    **dict.fromkeys(("position_inflation", "velocity_inflation"), "1"),
    "zero_yaw_rate": "rad/s",
}
"""Units of noise entries, by name."""

FIX_ENTRIES: Final = (
    "position_floor",
    "height_floor",
    "position_inflation",
    "velocity_floor",
    "velocity_inflation",
    "speed_noise",
)
"""Noise entries that say how far a fix is believed: R where a fix is measured."""

INITIAL = "initial."
"""What names of initial deviations begin with."""


def known_names(options: EkfOptions) -> tuple[str, ...]:
    """Return the names of all that may be tuned of a filter.

    Args:
        options: The filter.

    Returns:
        Noise entries that the filter's model uses, by their names in
        :class:`navlearn.fusion.noise_options.NoiseOptions`; then initial deviations as
        ``initial.gyro.scale``, but for those that the alignment tells.
    """
    return (*_used(options), *_initial(options))


def default_names(options: EkfOptions, spacing: float = 0.0) -> tuple[str, ...]:
    """Return the names of what is tuned where nothing else is asked for.

    Initial deviations are left alone: a drive is a single draw of them.

    Args:
        options: The filter.
        spacing: Time between the fixes that take part, s; where they are not all of them,
            :data:`FIX_ENTRIES` are left alone, too.

    Returns:
        Names, without those whose value is zero.
    """
    held = FIX_ENTRIES if spacing > 0.0 else ()
    used = (name for name in _used(options) if name not in held)
    return tuple(name for name in used if getattr(options.noise, name) > 0.0)


def unit_of(name: str) -> str:
    """Return the unit of an entry.

    Args:
        name: As :func:`known_names` tells it.
    """
    if name.startswith(INITIAL):
        return ERROR_UNITS[name.removeprefix(INITIAL).replace(".", "_")]
    return UNITS[name]


def _used(options: EkfOptions) -> tuple[str, ...]:
    kinds = measurement_rows(options).kinds
    shen, climbs = options.has_velocity_states, options.mechanization.three_d
    gnss_velocity = Kind.VELOCITY in kinds or Kind.COURSE in kinds
    use = {
        "gyro_random_walk": True,
        "turn_noise": True,
        "gyro_bias_walk": "bias" in options.gyro_states,
        "speed_scale_walk": "scale" in options.speed_states,
        "pitch_bias_walk": options.has_pitch_state,
        "position_walk": True,
        "height_walk": climbs,
        "hill_walk": not climbs,
        "velocity_walk": shen,
        "acceleration_walk": shen,
        "position_floor": Kind.POSITION in kinds,
        "height_floor": Kind.POSITION in kinds,
        "position_inflation": Kind.POSITION in kinds,
        "velocity_floor": gnss_velocity,
        "velocity_inflation": gnss_velocity,
        "speed_noise": Kind.VELOCITY in kinds,
        "zero_yaw_rate": Kind.ZERO_YAW_RATE in kinds,
        "zero_speed": Kind.ZERO_SPEED in kinds,
    }
    return tuple(entry.name for entry in fields(NoiseOptions) if use[entry.name])


def _initial(options: EkfOptions) -> tuple[str, ...]:
    names = []
    for state in error_layout(options).sensors:
        group, _, term = state.partition("_")
        if group in ("gyro", "speed") and state != "gyro_bias":
            names.append(f"{INITIAL}{group}.{term}")
        elif group not in ("gyro", "speed"):
            names.append(INITIAL + state)
    return tuple(names)


@dataclass(frozen=True)
class FreeParameters:
    """The free entries of one filter's noise.

    Attributes:
        options: The filter as it is before.
        names: What is free, in the order of the vector.
    """

    options: EkfOptions
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        """Refuse what cannot be tuned.

        Raises:
            ConfigError: A name is unknown, unused by the model, doubled, or its value is zero.
        """
        known = known_names(self.options)
        for name in self.names:
            if name not in known:
                raise ConfigError(
                    f"tuning: {name!r} is nothing that this filter uses; free may name "
                    f"{', '.join(known)}"
                )
            if not self.value(name) > 0.0:
                raise ConfigError(
                    f"tuning: {name} is zero, and no factor moves it; start from a value above 0"
                )
        if not self.names or len(set(self.names)) < len(self.names):
            raise ConfigError(f"tuning: free is {list(self.names)}; name some, each once")

    def value(self, name: str) -> float:
        """Return the value with which an entry starts."""
        if not name.startswith(INITIAL):
            return float(getattr(self.options.noise, name))
        group, _, term = name.removeprefix(INITIAL).partition(".")
        found = getattr(self.options.initial, group)
        return float(found[term] if term else found)

    @property
    def start(self) -> Tensor:
        """Logarithms at the start, shape (P,)."""
        return torch.tensor([math.log(self.value(n)) for n in self.names], dtype=torch.float64)

    def noise(self, logs: Tensor) -> EkfNoise:
        """Return the filter's noise, differentiable in the logarithms, shape (P,)."""
        all_logs = log_noise(self.options.noise)
        at = [i for i, name in enumerate(self.names) if not name.startswith(INITIAL)]
        where = [EkfNoise._fields.index(self.names[i]) for i in at]
        moved = all_logs.index_put((torch.tensor(where),), logs[at]) if at else all_logs
        return noise_from_log(moved)

    def started(self, start: Belief, logs: Tensor) -> Belief:
        """Return the belief before a drive with its initial deviations moved.

        Args:
            start: Belief with the options' own deviations, batch shape (...).
            logs: Shape (P,).
        """
        names = error_layout(self.options).names
        factor = [logs.new_zeros(())] * len(names)
        before = self.start
        for i, name in enumerate(self.names):
            if name.startswith(INITIAL):
                state = name.removeprefix(INITIAL).replace(".", "_")
                factor[names.index(state)] = logs[i] - before[i]
        scale = torch.exp(torch.stack(factor))
        covariance = start.covariance * scale.unsqueeze(-1) * scale
        return start._replace(covariance=covariance)

    def tuned(self, logs: Tensor) -> EkfOptions:
        """Return the filter's options with the free entries replaced.

        Args:
            logs: Shape (P,).
        """
        found = dict(zip(self.names, torch.exp(logs.detach()).tolist(), strict=True))
        return with_values(self.options, found)


def with_values(options: EkfOptions, values: Mapping[str, float]) -> EkfOptions:
    """Return options with noise entries and initial deviations replaced.

    Args:
        options: The filter.
        values: By name, as :func:`known_names` tells them.
    """
    noise = {k: v for k, v in values.items() if not k.startswith(INITIAL)}
    initial: dict[str, Any] = {}
    for name, value in values.items():
        if name.startswith(INITIAL):
            group, _, term = name.removeprefix(INITIAL).partition(".")
            whole = initial.get(group, getattr(options.initial, group))
            initial[group] = {**whole, term: value} if term else value
    return replace(
        options,
        noise=replace(options.noise, **noise),
        initial=replace(options.initial, **initial),
    )
