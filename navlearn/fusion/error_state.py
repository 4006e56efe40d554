"""The order of the error states, and how an error moves an estimate.

Position errors are metres east, north, up, so that the covariance is well scaled and means the
same anywhere on the Earth.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.options import EkfOptions
from navlearn.states import NavState

ERROR_UNITS: Final[dict[str, str]] = {
    **dict.fromkeys(("east", "north", "up"), "m"),
    **dict.fromkeys(("v_east", "v_north", "v_up"), "m/s"),
    **dict.fromkeys(("azimuth", "pitch_bias"), "rad"),
    **dict.fromkeys(("gyro_scale", "gyro_abs_scale", "speed_scale"), "1"),
    **dict.fromkeys(("gyro_f_x", "gyro_f_y"), "rad·s/m"),
    "acceleration_bias": "m/s²",
    "gyro_bias": "rad/s",
    "gyro_quadratic": "s/rad",
    "speed_delay": "s",
    "speed_offset": "m/s",
}
"""Units of the errors of all models, by name."""


@dataclass(frozen=True)
class ErrorLayout:
    """Where each error stands in the error state.

    Attributes:
        names: Name of each error, in order.
        azimuth: Index of the azimuth error.
        sensors: Names of the sensor parameters, in order.
    """

    names: tuple[str, ...]
    azimuth: int
    sensors: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of error states n."""
        return len(self.names)

    @property
    def first_sensor(self) -> int:
        """Index of the first sensor parameter."""
        return self.azimuth + 1

    @property
    def has_velocity(self) -> bool:
        """Whether velocity errors are states."""
        return self.azimuth == 6


def error_layout(options: EkfOptions) -> ErrorLayout:
    """Return the order of the error states of a model.

    Args:
        options: Choices of the filter.

    Returns:
        Layout; the sensor parameters are gyro terms, odometer terms, pitch bias, or for the Shen
        models odometer acceleration bias and gyro bias.
    """
    position = ("east", "north", "up")
    if options.has_velocity_states:
        sensors: tuple[str, ...] = ("acceleration_bias", "gyro_bias")
        names = (*position, "v_east", "v_north", "v_up", "azimuth", *sensors)
        return ErrorLayout(names, 6, sensors)
    sensors = tuple(f"gyro_{term}" for term in options.gyro_states)
    sensors += tuple(f"speed_{term}" for term in options.speed_states)
    sensors += ("pitch_bias",) if options.has_pitch_state else ()
    return ErrorLayout((*position, "azimuth", *sensors), 3, sensors)


def initial_sigmas(options: EkfOptions) -> Tensor:
    """Return the standard deviations of the error at the start.

    Args:
        options: Choices of the filter.

    Returns:
        Deviations in the order of :func:`error_layout`, shape (n,).
    """
    start = options.initial
    known = {
        "east": start.position,
        "north": start.position,
        "up": start.height,
        "v_east": start.velocity,
        "v_north": start.velocity,
        "v_up": start.velocity,
        "azimuth": start.azimuth,
        "acceleration_bias": start.acceleration_bias,
        "pitch_bias": start.pitch_bias,
        **{f"gyro_{term}": sigma for term, sigma in start.gyro.items()},
        **{f"speed_{term}": sigma for term, sigma in start.speed.items()},
    }
    names = error_layout(options).names
    return torch.tensor([known[name] for name in names], dtype=torch.float64)


def initial_belief(
    options: EkfOptions,
    state: NavState,
    *,
    sensor: dict[str, float | Tensor] | None = None,
    sigmas: dict[str, float | Tensor] | None = None,
) -> Belief:
    """Return the belief with which a filter starts.

    Args:
        options: Choices of the filter.
        state: Position and azimuth, shape (...) each.
        sensor: Sensor parameters known at alignment by name (``gyro_bias`` in rad/s, ...); the
            others start at zero. Names that the model does not have are left out.
        sigmas: Standard deviations by name that replace those of ``options.initial``.

    Returns:
        Belief with a diagonal covariance, batch shape (...).
    """
    layout = error_layout(options)
    batch, like = state.lat.shape, state.lat
    sigma = initial_sigmas(options).to(like).expand(*batch, layout.size).clone()
    for name, value in (sigmas or {}).items():
        if name in layout.names:
            sigma[..., layout.names.index(name)] = value
    parameters = like.new_zeros((*batch, len(layout.sensors)))
    for name, value in (sensor or {}).items():
        if name in layout.sensors:
            parameters[..., layout.sensors.index(name)] = value
    return Belief(
        state,
        parameters,
        like.new_zeros((*batch, 3)),
        torch.diag_embed(sigma * sigma),
        parameters.clone(),
        like.new_zeros((*batch, 5)),
    )


def shifted(state: NavState, correction: Tensor, azimuth: int) -> NavState:
    """Return a state moved by a correction (minus the estimated error).

    Args:
        state: State, shape (...) each.
        correction: In the order of the error state, shape (..., n).
        azimuth: Index of the azimuth error.

    Returns:
        State, shape (...) each.
    """
    lat, lon, height = shift_geodetic(
        state.lat,
        state.lon,
        state.height,
        correction[..., 0],
        correction[..., 1],
        correction[..., 2],
    )
    return NavState(lat, lon, height, state.azimuth + correction[..., azimuth])


def position_difference(state: NavState, reference: NavState) -> Tensor:
    """Return the position of a state relative to another, metres ENU.

    Args:
        state: State, shape (...) each.
        reference: State, shape (...) each.

    Returns:
        Difference, m, shape (..., 3).
    """
    difference = enu_between(
        state.lat, state.lon, state.height, reference.lat, reference.lon, reference.height
    )
    return torch.stack(difference, dim=-1)
