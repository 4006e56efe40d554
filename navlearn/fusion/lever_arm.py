"""The way from the navigating point to the GNSS antenna, and how errors turn it."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import matrix_from_angles
from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import ErrorLayout
from navlearn.fusion.sensor_errors import SensorErrors
from navlearn.states import RissSample


class LeverArm(NamedTuple):
    """Lever arm in ENU and its changes, shape (..., 3) each.

    Attributes:
        arm: Antenna from the navigating point, m.
        by_azimuth: Its change per azimuth, m/rad.
        by_pitch_bias: Its change per pitch bias, m/rad.
    """

    arm: Tensor
    by_azimuth: Tensor
    by_pitch_bias: Tensor


def turned_arm(
    errors: SensorErrors,
    lever_arm: tuple[float, float, float],
    belief: Belief,
    sample: RissSample,
) -> LeverArm:
    """Return a lever arm turned from body to local level.

    [Noureldin2013] §8.3.

    Args:
        errors: Sensor parameters of the filter.
        lever_arm: Antenna from the navigating point, body RFU, m.
        belief: Belief, batch shape (...).
        sample: Sample that tells pitch and roll, shape (...) each.

    Returns:
        Lever arm, batch shape (...).
    """
    azimuth = belief.state.azimuth
    zero = torch.zeros_like(azimuth)
    pitch, roll = zero, zero
    if errors.three_d:
        pitch, roll = sample.pitch, sample.roll
        if errors.pitch_bias:
            pitch = pitch - belief.sensor[..., -1]
    C_lb = matrix_from_angles(azimuth, pitch, roll)
    arm = C_lb @ torch.tensor(lever_arm, dtype=zero.dtype, device=zero.device)
    e, n, u = arm.unbind(-1)
    sine, cosine = torch.sin(azimuth), torch.cos(azimuth)
    ahead = e * sine + n * cosine
    return LeverArm(
        arm, torch.stack((n, -e, zero), -1), torch.stack((u * sine, u * cosine, -ahead), -1)
    )


def arm_columns(layout: ErrorLayout, errors: SensorErrors, arm: LeverArm) -> Tensor:
    """Return what a lever arm adds to the derivative of a predicted position.

    Args:
        layout: Order of the error states.
        errors: Sensor parameters of the filter.
        arm: Lever arm, batch shape (...).

    Returns:
        Derivative per error state, shape (..., 3, n).
    """
    n, azimuth = layout.size, layout.azimuth
    columns = torch.nn.functional.pad(arm.by_azimuth.unsqueeze(-1), (azimuth, n - azimuth - 1))
    if errors.pitch_bias:
        columns = columns + torch.nn.functional.pad(arm.by_pitch_bias.unsqueeze(-1), (n - 1, 0))
    return columns
