"""How well a filter observes what it estimates: its covariance against that of its start.

[Dahmane2022] (19)–(23), after [Ham1983]: eigenvalues and eigenvectors of the normalised
covariance name the combinations of states that measurements have and have not told. Two norms,
never one alone. P' is in initial deviations: an eigenvalue of 1 says that a direction is as
unknown as at the start, more that it has drifted away. P'' has trace n: it says who holds the
largest share of what is unknown now, and falls for a state that grows slower than the others.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.ekf import symmetrized
from navlearn.filters.observability import signed_columns


class NormalizedCovariance(NamedTuple):
    """A covariance in two norms.

    Attributes:
        against_start: P' = P₀^-½ P P₀^-½, in initial deviations, shape (..., K, n, n).
        share: P'' = (n / tr P') P', trace n, shape (..., K, n, n).
    """

    against_start: Tensor
    share: Tensor


class Degree(NamedTuple):
    """Directions by how well they are observed, best first.

    Attributes:
        against_start: Eigenvalues of P', ascending, at least 0, shape (..., K, n).
        share: Eigenvalues of P'', the same but for a factor per time; in [0, n], their sum is n,
            shape (..., K, n).
        directions: Unit eigenvectors in initial deviations, one column per eigenvalue, shape
            (..., K, n, n). The largest component of each is positive.
    """

    against_start: Tensor
    share: Tensor
    directions: Tensor


def normalized_covariance(covariance: Tensor, start: Tensor) -> NormalizedCovariance:
    """Return covariances relative to that of the start, in both norms.

    [Dahmane2022] (19)–(23). Of the covariance at the start its diagonal is taken.

    Args:
        covariance: P at each time, shape (..., K, n, n).
        start: P₀, its diagonal positive, shape (..., n, n).

    Returns:
        P' and P''.

    Raises:
        ShapeError: Shapes differ, or an initial variance is not positive.
    """
    n = covariance.shape[-1]
    variance = start.diagonal(dim1=-2, dim2=-1)
    if covariance.dim() < 3 or covariance.shape[-2] != n or variance.shape[-1] != n:
        raise ShapeError(
            f"normalized_covariance: found covariances {tuple(covariance.shape)} and start "
            f"{tuple(start.shape)}; expected (..., K, n, n) and (..., n, n)"
        )
    if not bool((variance > 0.0).all()):
        known = sorted({int(i) for i in (~(variance > 0.0)).nonzero()[:, -1]})
        raise ShapeError(
            f"normalized_covariance: the initial variance of state {known} is not positive; what "
            "is known at the start cannot be observed better: leave these states out"
        )
    scale = variance.rsqrt().unsqueeze(-2)
    against_start = symmetrized(covariance * (scale.unsqueeze(-1) * scale.unsqueeze(-2)))
    trace = against_start.diagonal(dim1=-2, dim2=-1).sum(-1)
    return NormalizedCovariance(against_start, against_start * (n / trace)[..., None, None])


def degree_of_observability(normalized: NormalizedCovariance) -> Degree:
    """Return eigenvalues and eigenvectors of a normalised covariance over time.

    [Ham1983].

    Args:
        normalized: P' and P''.

    Returns:
        Directions, the best observed first.
    """
    values, vectors = torch.linalg.eigh(normalized.against_start)
    values = values.clamp(min=0.0)  # rounding may leave the smallest a little below
    n = values.shape[-1]
    share = values * (n / values.sum(-1, keepdim=True))
    return Degree(values, share, signed_columns(vectors))


def main_components(
    direction: Tensor, names: Sequence[str], *, most: int = 3, least: float = 0.25
) -> list[tuple[str, float]]:
    """Return the largest components of a direction by name, in order of size.

    The square of a component of a unit vector is that state's part in the direction.

    Args:
        direction: Components, shape (n,).
        names: Of the states.
        most: How many at most; the largest is always there.
        least: Smallest size of any other, as a part of the largest.

    Returns:
        Names and components with their signs.

    Raises:
        ShapeError: There are not as many names as components.
    """
    if direction.shape != (len(names),):
        raise ShapeError(
            f"main_components: {len(names)} names for components of shape {tuple(direction.shape)}"
        )
    values = direction.tolist()
    order = sorted(range(len(values)), key=lambda i: -abs(values[i]))[:most]
    floor = least * abs(values[order[0]])
    return [(names[i], values[i]) for i in order if abs(values[i]) >= floor]


def direction_in_words(
    direction: Tensor, names: Sequence[str], *, most: int = 3, least: float = 0.25
) -> str:
    """Return a direction by its largest components, such as "azimuth 0.93, gyro bias z 0.31".

    Args:
        direction: Components, shape (n,).
        names: Of the states; underscores become blanks.
        most: How many components at most.
        least: Smallest size of any but the largest, as a part of it.

    Raises:
        ShapeError: There are not as many names as components.
    """
    found = main_components(direction, names, most=most, least=least)
    told = (f"{name.replace('_', ' ')} {value:.2f}" for name, value in found)
    return ", ".join(told).replace("-", "−")
