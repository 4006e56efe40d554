"""What is white and what wanders in a series of increments.

The tools are those of the Allan variance: half the mean square of the change from one window to
the next. At the shortest window it is white noise, whatever drifts beneath; at a long one, less
the white noise that is left there, it is a random walk ([IEEE952] annex C).
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

FEWEST_WINDOWS = 4
"""Fewest windows from which a walk is told."""


class WindowValues(NamedTuple):
    """A parameter estimated in W windows.

    Attributes:
        number: Number of each window, int64, rising, shape (W,).
        value: Estimate, shape (W,).
        variance: Of the estimate, by the white noise alone, shape (W,).
        of: Window of every stretch, as an index into the above, int64, shape (K,).
    """

    number: Tensor
    value: Tensor
    variance: Tensor
    of: Tensor


def window_values(
    error: Tensor, by: Tensor, variance: Tensor, place: Tensor, size: int
) -> WindowValues:
    """Return the parameter that explains errors best, window by window.

    Weighted least squares of error = value · by + white noise.

    Args:
        error: Errors of stretches, shape (K,).
        by: Their derivative by the parameter, shape (K,).
        variance: Of their white noise, shape (K,).
        place: Numbers of the stretches, int64, shape (K,).
        size: Stretches per window.
    """
    number, of = torch.unique(place // size, return_inverse=True)
    zero = error.new_zeros(len(number))
    information = zero.index_add(0, of, by * by / variance).clamp(min=1e-300)
    value = zero.index_add(0, of, by * error / variance) / information
    return WindowValues(number, value, 1.0 / information, of)


def random_walk(values: WindowValues, length: float) -> float | None:
    """Return the random walk of a parameter from its values in neighbouring windows.

    Half the mean square change of means over windows of length T is q² T / 3 for a walk of
    density q². What is found is never less than its own standard deviation: few windows do not
    show that nothing wanders.

    Args:
        values: The parameter's values.
        length: Length of a window, s.

    Returns:
        q, the parameter's unit per √s; None where too few windows are neighbours.
    """
    known = values.variance < 20.0 * values.variance.median()
    number, value, variance = (part[known] for part in values[:3])
    pair = torch.diff(number) == 1
    pairs = int(pair.sum())
    if pairs < FEWEST_WINDOWS - 1:
        return None
    changes = 0.5 * torch.diff(value)[pair] ** 2
    white = 0.5 * (variance[1:] + variance[:-1])[pair]
    level = float(changes.mean())
    deviation = level * (2.0 / pairs) ** 0.5
    density = max(level - float(white.mean()), deviation) * 3.0 / length
    return math.sqrt(density)


def white_density(error: Tensor, place: Tensor, span: float, *, drifting: bool) -> float:
    """Return the density of white noise in errors of stretches, unit² per s.

    Args:
        error: Errors, shape (K,).
        place: Numbers of the stretches, int64, shape (K,).
        span: Their length, s.
        drifting: Whether a state explains what changes slowly: then only changes from one
            stretch to the next count.
    """
    if not drifting:
        return float((error * error).mean()) / span
    neighbours = torch.diff(place) == 1
    change = torch.diff(error)[neighbours]
    return 0.5 * float((change * change).mean()) / span


def sums_over(values: Tensor, place: Tensor, size: int) -> Tensor:
    """Return sums over windows that have all their stretches, shape (W,).

    Args:
        values: One value per stretch, shape (K,).
        place: Numbers of the stretches, int64, shape (K,).
        size: Stretches per window.
    """
    number, of = torch.unique(place // size, return_inverse=True)
    count = torch.bincount(of, minlength=len(number))
    return values.new_zeros(len(number)).index_add(0, of, values)[count == size]


def fitted(error: Tensor, by: Tensor, place: Tensor | None = None, size: int = 0) -> Tensor:
    """Return coefficients of a least-squares fit of errors.

    Args:
        error: Errors, shape (K,).
        by: Regressors, shape (K, p).
        place: Numbers of the stretches, int64, shape (K,); where given, every window has a level
            of its own beside.
        size: Stretches per such window.

    Returns:
        Coefficients, shape (p,); zeros for regressors that never differ from zero.
    """
    if by.shape[-1] == 0:
        return error.new_zeros(0)
    if place is not None:
        error, by = (
            _without_levels(error[:, None], place, size)[:, 0],
            _without_levels(by, place, size),
        )
    scale = by.square().mean(0).sqrt()
    used = scale > 0.0
    found = error.new_zeros(by.shape[-1])
    if bool(used.any()):
        solved = torch.linalg.lstsq(by[:, used] / scale[used], error[:, None]).solution[:, 0]
        found[used] = solved / scale[used]
    return found


def _without_levels(columns: Tensor, place: Tensor, size: int) -> Tensor:
    number, of = torch.unique(place // size, return_inverse=True)
    count = torch.bincount(of, minlength=len(number)).unsqueeze(-1)
    total = columns.new_zeros((len(number), columns.shape[-1])).index_add(0, of, columns)
    return columns - (total / count)[of]
