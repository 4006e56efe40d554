"""What a filter's noise makes of a typical fix: the deviation that it is believed with."""

from collections.abc import Sequence

import torch
from torch import Tensor

from navlearn.fusion.measurements import Kind
from navlearn.learning.drive_likelihood import DriveLikelihood
from navlearn.learning.noise_parameters import FreeParameters

Deviation = tuple[str, str, Tensor]


def fix_deviations(
    drives: Sequence[DriveLikelihood], parameters: FreeParameters, logs: Tensor
) -> list[Deviation]:
    """Return the deviations with which a filter believes typical fixes.

    Typical is the median of what the receivers tell.

    Args:
        drives: Drives behind the filter.
        parameters: What is free of its noise.
        logs: Logarithms of that, shape (P,).

    Returns:
        Name, unit and deviation, shape (), of what the filter measures.
    """
    noise, kinds = parameters.noise(logs), drives[0].model.rows.kinds
    found: list[Deviation] = []
    if Kind.POSITION in kinds:
        for name, told, floor in (
            ("fix, east and north", _median(drives, "std_e", "has_position"), noise.position_floor),
            ("fix, up", _median(drives, "std_u", "has_position"), noise.height_floor),
        ):
            if told is not None:
                variance = (told * noise.position_inflation) ** 2 + floor**2
                found.append((name, "m", variance.sqrt()))
    told = _median(drives, "std_v", "has_velocity")
    if Kind.VELOCITY in kinds and told is not None:
        variance = (told * noise.velocity_inflation) ** 2
        variance = variance + noise.velocity_floor**2 + noise.speed_noise**2
        found.append(("velocity of a fix", "m/s", variance.sqrt()))
    return found


def _median(drives: Sequence[DriveLikelihood], channel: str, where: str) -> Tensor | None:
    parts = []
    for drive in drives:
        fix = drive.line.occasion.fix
        parts.append(getattr(fix, channel)[getattr(fix, where) > 0.5])
    told = torch.cat(parts)
    return torch.median(told) if told.numel() > 0 else None
