"""With what a full-IMU filter starts: belief, and samples less what it has no states for."""

from collections.abc import Mapping

import torch
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.layout import INS_ERROR_UNITS, InsLayout, ins_layout
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.mechanization.increments import inertial_errors_removed
from navlearn.mechanization.ins_alignment import InsAlignment
from navlearn.states import ImuSample, InsState

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


def aligned_ins_belief(options: InsEkfOptions, alignment: InsAlignment) -> InsBelief:
    """Return the belief that an alignment justifies.

    Args:
        options: Choices of the filter.
        alignment: Where and with what the filter starts.

    Returns:
        Belief, no batch axis.
    """
    told = ("position", "height", "velocity", "gyro_bias", "accel_bias")
    sigmas: dict[str, float | Tensor] = {x: getattr(alignment, f"{x}_sigma") for x in told}
    sigmas |= zip(("phi_east", "phi_north", "phi_up"), alignment.attitude_sigma, strict=True)
    sensor = {"gyro_bias": alignment.gyro_bias, "accel_bias": alignment.accel_bias}
    return initial_ins_belief(options, alignment.state, sensor=sensor, sigmas=sigmas)


def calibrated(options: InsEkfOptions, samples: ImuSample, alignment: InsAlignment) -> ImuSample:
    """Return samples less alignment's biases where the filter has no states for them.

    Args:
        options: Choices of the filter.
        samples: Samples, shape (T,) and (T, 3) each.
        alignment: What it found.

    Returns:
        Samples of the same shape.
    """
    if ins_layout(options).has_bias:
        return samples
    return inertial_errors_removed(samples, alignment.gyro_bias, alignment.accel_bias)


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
