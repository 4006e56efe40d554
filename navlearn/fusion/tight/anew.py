"""What of an estimate is set or begins anew before ranges are judged."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.clock import BIAS, DRIFT
from navlearn.fusion.tight.model import TightModel

FARTHEST = 3e4
"""Largest deviation with which a position begins anew, m: farther off ranges are not linear."""

TILT = 0.05
"""Deviation added to tilt where position begins anew, in parts of what is added to azimuth."""


class Anew(NamedTuple):
    """What is set or begins anew.

    Attributes:
        shift: By how much the clock states are moved, m and m/s, shape (..., c).
        variance: Variance added to the error states and the surprises, shape (..., N).
    """

    shift: Tensor
    variance: Tensor


class Flags(NamedTuple):
    """What shall begin anew, bool, shape (...) each.

    Attributes:
        clock: Clock states, shape (..., c).
        motion: Velocity states and azimuth.
        position: Position.
    """

    clock: Tensor
    motion: Tensor
    position: Tensor


def clock_set(model: TightModel, found: Measured, variance: Tensor, there: Tensor) -> Anew:
    """Return by how much the clock is moved where it is unknown.

    Satellites of a system whose offset is known tell the bias; where there are none, all do.

    Args:
        model: The filter.
        found: What is measured, shape (...).
        variance: Variance of the error states and the surprises, shape (..., N).
        there: Whether something is measured, bool, shape (..., 2 S).

    Returns:
        Shift; no variance is added.
    """
    innovation, by_clock, present = _of_ranges(model, found, there)
    first, last = model.first_clock, model.size
    unknown = variance[..., first:last] > model.options.gate.unknown_clock**2
    unknown = unknown & (_places(by_clock) != DRIFT)
    lost = (by_clock[..., DRIFT + 1 :] > 0.5) & unknown[..., None, DRIFT + 1 :]
    told = present & ~lost.any(-1)
    told = torch.where(told.any(-1, keepdim=True), told, present)
    bias = torch.where(unknown[..., BIAS], common(innovation, told), 0.0)
    shift = _with_offsets(innovation, by_clock, present, bias, torch.zeros_like(bias), unknown)
    return Anew(shift, torch.zeros_like(variance))


def begun_anew(
    model: TightModel, found: Measured, there: Tensor, before: Anew, flags: Flags
) -> Anew:
    """Return what begins anew: moved by what all innovations share, and opened.

    Args:
        model: The filter.
        found: What is measured, shape (...).
        there: Whether something is measured, bool, shape (..., 2 S).
        before: What was set before.
        flags: What shall begin anew.

    Returns:
        Shift, that before included, and variance.
    """
    left = found.innovation - told_by_clock(model, found, before.shift)
    innovation, by_clock, present = _of_ranges(model, found._replace(innovation=left), there)
    count = innovation.shape[-1]
    bias = torch.where(flags.clock[..., BIAS], common(innovation, present), 0.0)
    rates = common(left[..., count:], there[..., count:])
    drift = torch.where(flags.clock[..., DRIFT], rates, 0.0)
    shift = _with_offsets(innovation, by_clock, present, bias, drift, flags.clock)
    off = (innovation - shift[..., :1]).detach().abs()
    variance = _variance(model, flags, common(off, present))
    beside = found.observation.shape[-1] - model.size
    return Anew(before.shift + shift, torch.nn.functional.pad(variance, (0, beside)))


def told_by_clock(model: TightModel, found: Measured, shift: Tensor) -> Tensor:
    """Return what moving the clock does to predictions, shape (..., 2 S).

    Args:
        model: The filter.
        found: What is measured, shape (...).
        shift: By how much the clock states are moved, shape (..., c).
    """
    by_clock = found.observation[..., model.first_clock : model.size]
    return (by_clock @ shift.unsqueeze(-1)).squeeze(-1)


def common(values: Tensor, use: Tensor) -> Tensor:
    """Return the median of some values (the lower one of two), zero where there are none.

    Args:
        values: Shape (..., S).
        use: Which of them count, bool, shape (..., S).

    Returns:
        Shape (...).
    """
    number = use.sum(-1, keepdim=True)
    ordered = torch.where(use, values, torch.inf).sort(-1).values
    middle = torch.gather(ordered, -1, ((number - 1) // 2).clamp(min=0))
    return torch.where(number > 0, middle, 0.0).squeeze(-1)


def _of_ranges(model: TightModel, found: Measured, there: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return innovations, clock columns and presence of pseudoranges alone."""
    count = there.shape[-1] // 2
    by_clock = found.observation[..., :count, model.first_clock : model.size]
    return found.innovation[..., :count], by_clock, there[..., :count]


def _with_offsets(
    innovation: Tensor,
    by_clock: Tensor,
    present: Tensor,
    bias: Tensor,
    drift: Tensor,
    move: Tensor,
) -> Tensor:
    """Return shifts of bias and drift, and those of the offsets that shall move beside them."""
    left = innovation - bias.unsqueeze(-1)
    shift = [bias, drift]
    for j in range(DRIFT + 1, by_clock.shape[-1]):
        own = present & (by_clock[..., j] > 0.5)
        shift.append(torch.where(move[..., j], common(left, own), 0.0))
    return torch.stack(shift, -1)


def _variance(model: TightModel, flags: Flags, off: Tensor) -> Tensor:
    """Return the variance added to error states; ``off`` is how far off ranges mostly are."""
    gate, turn = model.options.gate, model.vehicle.gate.reset_azimuth
    clock = off.new_full((model.size - model.first_clock,), gate.anew_clock)
    clock[DRIFT] = gate.anew_drift
    position, motion = [0.0] * model.first_clock, [0.0] * model.first_clock
    for k, name in enumerate(model.vehicle.names):
        if name in ("east", "north", "up"):
            position[k] = 1.0
        elif name in ("v_east", "v_north", "v_up"):
            motion[k] = gate.anew_velocity
        elif name in ("azimuth", "phi_up"):
            motion[k] = turn
        elif name in ("phi_east", "phi_north"):
            motion[k] = TILT * turn
    far = torch.clamp(3.0 * off, max=FARTHEST).clamp(min=gate.anew_position).unsqueeze(-1)
    placed = far * off.new_tensor(position) * flags.position.unsqueeze(-1)
    moving = off.new_tensor(motion) * flags.motion.unsqueeze(-1)
    deviation = torch.cat((placed + moving, clock * flags.clock), -1)
    return deviation * deviation


def _places(by_clock: Tensor) -> Tensor:
    return torch.arange(by_clock.shape[-1], device=by_clock.device)
