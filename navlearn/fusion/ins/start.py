"""The belief with which a full-IMU filter starts."""

from collections.abc import Mapping

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.layout import INS_ERROR_UNITS, InsLayout, ins_layout
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.states import InsState

GROUPS: dict[str, tuple[str, ...]] = {
    "position": ("east", "north"),
    "height": ("up",),
    "velocity": ("v_east", "v_north", "v_up"),
    "tilt": ("phi_east", "phi_north"),
    "azimuth": ("phi_up",),
    "odometer_scale": ("odometer_scale",),
    **{
        kind: tuple(f"{kind}_{axis}" for axis in "xyz")
        for kind in ("gyro_bias", "accel_bias", "gyro_scale", "accel_scale")
    },
}
"""Errors that share one standard deviation, by the names of ``InsInitialOptions``."""


def initial_ins_sigmas(options: InsEkfOptions) -> Tensor:
    """Return the standard deviations of the error at the start.

    Args:
        options: Choices of the filter.

    Returns:
        Deviations in the order of :func:`navlearn.fusion.ins.layout.ins_layout`, shape (n,).
    """
    known = {n: getattr(options.initial, g) for g, members in GROUPS.items() for n in members}
    return torch.tensor([known[n] for n in ins_layout(options).names], dtype=torch.float64)


def initial_ins_belief(
    options: InsEkfOptions,
    state: InsState,
    *,
    sensor: Mapping[str, float | Tensor] | None = None,
    sigmas: Mapping[str, float | Tensor] | None = None,
) -> InsBelief:
    """Return the belief with which a filter starts.

    Names are those of one error (``gyro_bias_z``, ``phi_up``) or of a group of
    ``InsInitialOptions`` (``gyro_bias``, ``tilt``, ``azimuth``). What belongs to a state that the
    filter does not have is left out.

    Args:
        options: Choices of the filter.
        state: Position, velocity and attitude, batch shape (...).
        sensor: Sensor parameters known at alignment, by name: a value, shape (...), or for a
            group of three one per axis, shape (..., 3); the others start at zero.
        sigmas: Standard deviations that replace those of ``options.initial``, alike.

    Returns:
        Belief with a diagonal covariance, batch shape (...).

    Raises:
        ConfigError: If a name is unknown.
    """
    layout = ins_layout(options)
    batch, like = state.lat.shape, state.lat
    sigma = initial_ins_sigmas(options).to(like).expand(*batch, layout.size).clone()
    parameters = like.new_zeros((*batch, layout.size))
    _set(sigma, layout, sigmas or {}, "sigmas")
    _set(parameters, layout, sensor or {}, "sensor")
    return InsBelief(
        state,
        parameters[..., 9:].clone(),
        torch.diag_embed(sigma * sigma),
        like.new_zeros((*batch, len(InsKind))),
    )


def _set(
    target: Tensor, layout: InsLayout, values: Mapping[str, float | Tensor], what: str
) -> None:
    for name, value in values.items():
        members = GROUPS.get(name, (name,))
        if not set(members) <= set(INS_ERROR_UNITS):
            known = ", ".join([*GROUPS, *INS_ERROR_UNITS])
            raise ConfigError(f"initial_ins_belief: {what} names {name!r}; choose among {known}")
        places = [layout.names.index(n) for n in members if n in layout.names]
        if not places:
            continue
        like = torch.as_tensor(value, dtype=target.dtype, device=target.device)
        per_axis = len(places) == 3 and like.dim() > 0 and like.shape[-1] == 3
        target[..., places] = like if per_axis else like.unsqueeze(-1)
