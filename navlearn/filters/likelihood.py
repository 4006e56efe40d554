"""How well a filter foretold what was measured: the log-density of its innovations.

The innovations of a filter that is right are independent from one time to the next, so that the
likelihood of a drive is a product of densities, [BarShalom2001] §5.4 and [Mehra1970]. Within one
time the kinds of measurement are taken one after another, each given those before it: a product
again, by one Cholesky factor.

Every measurement is foretold, also one that the filter then refuses. A density that counted only
what was believed would rise with every refusal; this one counts the same measurements whatever
the noise, so that refusing earns nothing. Student's density with a few degrees of freedom keeps
a wild measurement from deciding; its width is set so that innovations that are normal call for
the same covariance that they have.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError


class Whitened(NamedTuple):
    """Innovations row by row, each given the rows before it.

    Attributes:
        square: Squared normalised innovation, shape (..., r).
        log_variance: Logarithm of its variance, shape (..., r).
    """

    square: Tensor
    log_variance: Tensor


def whitened(innovation: Tensor, spread: Tensor, variance: Tensor, together: Tensor) -> Whitened:
    """Return innovations made independent, row by row.

    Args:
        innovation: Measured minus predicted, shape (..., r).
        spread: H P Hᵀ of the prediction's covariance, shape (..., r, r).
        variance: Diagonal of R, shape (..., r).
        together: 1.0 where two rows tell of each other, 0.0 where they are to be taken apart
            (rows of a refused kind, which shall not spoil the others), shape (..., r, r).

    Returns:
        Squares and variances whose sums make up νᵀ S⁻¹ ν and log |S|.
    """
    total = spread * together + torch.diag_embed(variance)
    # _ex raises nothing: a matrix that is not positive shows as NaN, which callers look for
    factor = torch.linalg.cholesky_ex(total)[0]
    white = torch.linalg.solve_triangular(factor, innovation.unsqueeze(-1), upper=False)
    diagonal = factor.diagonal(dim1=-2, dim2=-1)
    return Whitened((white * white).squeeze(-1), 2.0 * torch.log(diagonal))


def gaussian_log_density(square: Tensor, log_variance: Tensor, degrees: Tensor) -> Tensor:
    """Return the log-density of normal innovations.

    Args:
        square: νᵀ S⁻¹ ν, shape (...).
        log_variance: log |S|, shape (...).
        degrees: Number of rows, shape (...).

    Returns:
        Log-density, nats, shape (...).
    """
    return -0.5 * (square + log_variance + degrees * math.log(2.0 * math.pi))


def student_log_density(
    square: Tensor, log_variance: Tensor, degrees: Tensor, freedom: float
) -> Tensor:
    """Return the log-density of innovations by Student's distribution about their covariance.

    Its scale matrix is S times :func:`student_scale`.

    Args:
        square: νᵀ S⁻¹ ν, shape (...).
        log_variance: log |S|, shape (...).
        degrees: Number of rows, zero for none, shape (...).
        freedom: Degrees of freedom of the distribution.

    Returns:
        Log-density, nats, zero where there are no rows, shape (...).
    """
    largest = int(degrees.max()) if degrees.numel() > 0 else 0
    table = [1.0] + [student_scale(d, freedom) for d in range(1, largest + 1)]
    scale = degrees.new_tensor(table)[degrees.to(torch.int64)]
    half = 0.5 * (degrees + freedom)
    constant = torch.lgamma(half) - math.lgamma(0.5 * freedom)
    constant = constant - 0.5 * degrees * torch.log(freedom * math.pi * scale)
    density = constant - 0.5 * log_variance - half * torch.log1p(square / (freedom * scale))
    return torch.where(degrees > 0.5, density, 0.0)


@lru_cache(maxsize=64)
def student_scale(degrees: int, freedom: float) -> float:
    """Return the scale of Student's density that suits normal innovations of covariance one.

    It solves E[(freedom + d) q / (freedom · scale + q)] = d for q distributed as χ² with d
    degrees: the derivative of the log-density by a factor on S then vanishes where S is right.

    Args:
        degrees: Number of rows d, 1 or more.
        freedom: Degrees of freedom of the density.

    Returns:
        Scale, between 0 and 1.

    Raises:
        ConfigError: If either is not positive.
    """
    if degrees < 1 or not 0.0 < freedom < math.inf:
        raise ConfigError(
            f"student_scale: found {degrees} rows and freedom {freedom}; expected one row or more "
            "and a finite freedom above 0"
        )
    radius = torch.linspace(0.0, 12.0 + math.sqrt(degrees), 4001, dtype=torch.float64)[1:]
    weight = torch.exp((degrees - 1) * torch.log(radius) - 0.5 * radius**2)
    weight, square = weight / weight.sum(), radius**2

    def pull(scale: float) -> float:
        terms = (freedom + degrees) * square / (freedom * scale + square)
        return float((weight * terms).sum()) - degrees

    low, high = 1e-3, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pull(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)
