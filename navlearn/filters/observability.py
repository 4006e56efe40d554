"""What a window of measurements can tell of the error at its start: observability matrix and rank.

Piecewise-constant systems after [GoshenMeskin1992], as in [Dahmane2022] (19)–(23). The rank is
taken after scaling: columns by the initial deviations, so that metres and radians compare, rows by
the deviations of the measurements, so that a singular value s is a signal-to-noise ratio. One
deviation of error in its direction shows as s deviations of measurement, and what is left of it
after the window is 1/√(1 + s²) of what it was.
"""

from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, ShapeError

Form = Literal["total", "stripped"]

TOLERANCE = 1e-9
"""Singular values count from this share of the largest on: far above rounding (1e-16), below what
Earth rate shows in some seconds. Over longer windows effects of second order, such as the Coriolis
force of a straight drive, come near it: look at the values themselves, or choose 1e-7."""


class Observed(NamedTuple):
    """What a window of measurements tells.

    Attributes:
        rank: Directions that show at all: singular values above the tolerance, int64, shape (...).
        singular_values: Deviations of measurement that one initial deviation in a direction shows
            as, descending, shape (..., n).
        directions: Unit vectors in initial deviations, one column per singular value, the largest
            component positive, shape (..., n, n). The columns from ``rank`` on span what is
            unobservable.
        left: What measurements without process noise leave of the initial deviation in each
            direction, in (0, 1], shape (..., n).
    """

    rank: Tensor
    singular_values: Tensor
    directions: Tensor
    left: Tensor


def observability_matrix(
    transition: Tensor, observation: Tensor, *, form: Form = "total"
) -> Tensor:
    """Return the observability matrix of a window, relative to the error at its start.

    [GoshenMeskin1992]. Step k carries the error through Φ_k and then measures
    H_k of it. ``total`` has the rows H_k Φ_k … Φ_1, which is exact for any linear system.
    ``stripped`` takes every step as a segment of its own that lasts for n measurements, rows
    H_k Φ_k^j with j < n, and forgets what segments do to the error on their way. It has the
    same rank where no segment moves what it cannot see; it may have more where steps are few,
    because it lets each go on for n measurements.

    Args:
        transition: Φ of each step, shape (..., K, n, n).
        observation: H of each step, in rows of any unit, shape (..., K, r, n).
        form: ``total`` or ``stripped``.

    Returns:
        Shape (..., K r, n), stripped (..., K n r, n).

    Raises:
        ShapeError: Transition and observation do not belong together.
        ConfigError: There is no such form.
    """
    _check_steps(transition, observation)
    if form == "stripped":
        return _segments(transition, observation).flatten(-4, -2)
    if form != "total":
        raise ConfigError(f"observability_matrix: found form {form!r}, expected total or stripped")
    rows: list[Tensor] = []
    moved = torch.eye(transition.shape[-1], dtype=transition.dtype, device=transition.device)
    for phi, seen in zip(transition.unbind(-3), observation.unbind(-3), strict=True):
        moved = phi @ moved
        rows.append(seen @ moved)
    return torch.cat(rows, -2)


def observability_rank(
    matrix: Tensor,
    deviations: Tensor,
    *,
    noise: Tensor | None = None,
    tolerance: float = TOLERANCE,
) -> Observed:
    """Return rank, singular values and directions of a scaled observability matrix.

    Args:
        matrix: Observability matrix, shape (..., m, n).
        deviations: Initial standard deviations of the states, all positive, shape (..., n).
        noise: Standard deviations of the measurements, shape (..., m) or, the same for every
            step, (..., r) with m a multiple of r; None leaves rows as they are, and then only
            ``rank`` and ``directions`` mean what they say.
        tolerance: A singular value counts if it is above this share of the largest.

    Returns:
        What is observed, and what is not.

    Raises:
        ShapeError: Deviations do not fit the matrix, or one is not positive.
    """
    n = matrix.shape[-1]
    _check_deviations(deviations, n, "deviations")
    scaled = matrix * deviations.unsqueeze(-2)
    if noise is not None:
        _check_deviations(noise, noise.shape[-1], "noise")
        if matrix.shape[-2] % noise.shape[-1] != 0:
            raise ShapeError(
                f"observability_rank: {noise.shape[-1]} deviations of measurements for a matrix of "
                f"{matrix.shape[-2]} rows; give one per row, or one per row of a step"
            )
        repeats = matrix.shape[-2] // noise.shape[-1]
        scaled = scaled / noise.repeat(*([1] * (noise.dim() - 1)), repeats).unsqueeze(-1)
    if scaled.shape[-2] < n:  # so that the directions which nothing measures are returned, too
        scaled = torch.nn.functional.pad(scaled, (0, 0, 0, n - scaled.shape[-2]))
    _, values, directions = torch.linalg.svd(scaled, full_matrices=False)
    rank = (values > tolerance * values[..., :1]).sum(-1)
    columns = signed_columns(directions.transpose(-1, -2))
    return Observed(rank, values, columns, torch.rsqrt(1.0 + values * values))


def signed_columns(directions: Tensor) -> Tensor:
    """Return directions of which the largest component is positive: their sign means nothing.

    Args:
        directions: One per column, shape (..., n, m).

    Returns:
        Shape (..., n, m).
    """
    place = directions.abs().argmax(-2, keepdim=True)
    return directions * torch.sign(torch.gather(directions, -2, place))


def unobservable(found: Observed) -> Tensor:
    """Return the directions that a window says nothing of.

    Args:
        found: What one window tells, without batch axes.

    Returns:
        Orthonormal columns in initial deviations, shape (n, n − rank).

    Raises:
        ShapeError: Several windows were given, whose ranks may differ.
    """
    if found.rank.dim() > 0:
        raise ShapeError(
            f"unobservable: found windows of shape {tuple(found.rank.shape)}; give one at a time"
        )
    return found.directions[:, int(found.rank) :]


def hidden_parts(found: Observed) -> Tensor:
    """Return how much of every state lies in what a window says nothing of.

    Unlike single directions this does not depend on the basis in which they are told.

    Args:
        found: What windows tell, batch shape (...).

    Returns:
        Squared length of each state's projection, 0 for one that is observed, 1 for one of which
        nothing is known, shape (..., n).
    """
    order = torch.arange(found.left.shape[-1], device=found.left.device)
    hidden = (order >= found.rank.unsqueeze(-1)).to(found.left)
    return (found.directions**2 * hidden.unsqueeze(-2)).sum(-1)


def left_of_states(found: Observed) -> Tensor:
    """Return what a window leaves of every state's deviation at its start.

    Args:
        found: What windows tell, with rows scaled by their noise, batch shape (...).

    Returns:
        Standard deviation given the window, against the initial one, shape (..., n).
    """
    return (found.directions**2 * (found.left**2).unsqueeze(-2)).sum(-1).sqrt()


def _segments(transition: Tensor, observation: Tensor) -> Tensor:
    """Return H Φ^j of every step, shape (..., K, n, r, n)."""
    rows = [observation]
    for _ in range(transition.shape[-1] - 1):
        rows.append(rows[-1] @ transition)
    return torch.stack(rows, -3)


def _check_steps(transition: Tensor, observation: Tensor) -> None:
    n = transition.shape[-1]
    fits = (
        transition.dim() >= 3
        and transition.dim() == observation.dim()
        and transition.shape[-2] == n == observation.shape[-1]
        and transition.shape[:-2] == observation.shape[:-2]
    )
    if not fits or transition.shape[-3] == 0:
        raise ShapeError(
            f"observability: found transitions {tuple(transition.shape)} and observations "
            f"{tuple(observation.shape)}; expected (..., K, n, n) and (..., K, r, n), K at least 1"
        )


def _check_deviations(values: Tensor, count: int, name: str) -> None:
    if values.shape[-1:] != (count,) or not bool((values > 0.0).all()):
        raise ShapeError(
            f"observability: {name} of shape {tuple(values.shape)} with least "
            f"{float(values.min()) if values.numel() else float('nan'):g}; expected {count} "
            "positive ones (leave out states that are known exactly)"
        )
