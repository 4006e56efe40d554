"""Candidate terms of FOS: products of lagged inputs and outputs, never held as a matrix.

Source: [Shen2010] §3 for the candidates. Every candidate of degree two or less is a product of
two columns of X = [1, lagged channels], so the correlations of all of them with a vector v are
the upper triangle of XᵀdiagvX: a matrix product, whose operands are one block of columns and X.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from navlearn.error_models.fos_options import FosOptions
from navlearn.errors import ConfigError, ShapeError

Term = tuple[tuple[int, int], ...]
"""Factors of a product as pairs of channel and lag; the output is the channel after the inputs."""

BLOCK = 40


def factor_list(inputs: int, options: FosOptions) -> list[Term]:
    """Return what each column of X stands for: the constant, inputs by lag, outputs by lag."""
    columns: list[Term] = [()]
    columns += [((c, lag),) for lag in range(options.lags + 1) for c in range(inputs)]
    columns += [((inputs, lag),) for lag in range(1, options.output_lags + 1)]
    return columns


def read_terms(nested: Sequence[Any], inputs: int, options: FosOptions) -> tuple[Term, ...]:
    """Return terms from nested lists of channel and lag.

    Raises:
        ConfigError: One is no candidate of these options.
    """
    known = factor_list(inputs, options)
    terms: list[Term] = [tuple((c, lag) for c, lag in term) for term in nested]
    for term in terms:
        if len(term) > options.degree or any((factor,) not in known for factor in term):
            raise ConfigError(f"fos: term {term} is no candidate of these options")
    return tuple(terms)


def lagged_columns(u: Tensor, y: Tensor, options: FosOptions) -> Tensor:
    """Return X transposed, window by window, for the rows that have a whole past.

    Args:
        u: Inputs, shape (..., T, m).
        y: Output, shape (..., T).
        options: Lags.

    Returns:
        Shape (..., c, T − memory).

    Raises:
        ShapeError: The shapes do not belong together, or the windows are no longer than the lags.
    """
    memory = max(options.lags, options.output_lags)
    if u.ndim < 2 or u.shape[:-1] != y.shape:
        raise ShapeError(
            f"fos: inputs have shape {tuple(u.shape)} and the target {tuple(y.shape)}; expected "
            "(..., T, m) and (..., T)"
        )
    steps = u.shape[-2]
    if steps <= memory:
        raise ShapeError(f"fos: {steps} rows are too few for {memory} lags; give longer windows")
    columns, inputs = len(factor_list(u.shape[-1], options)), u.shape[-1]
    x = torch.ones(*y.shape[:-1], columns, steps - memory, dtype=torch.float64)
    for lag in range(options.lags + 1):
        block = slice(1 + lag * inputs, 1 + (lag + 1) * inputs)
        x[..., block, :] = u[..., memory - lag : steps - lag, :].mT
    for lag in range(1, options.output_lags + 1):
        x[..., columns - 1 - options.output_lags + lag, :] = y[..., memory - lag : steps - lag]
    return x


@dataclass(frozen=True)
class Candidates:
    """Products of two columns, weighted, in each of B windows.

    A table holds one number per candidate, element (i, j) with i ≤ j for the product of columns i
    and j, and zeros below; it is handed on flat.

    Attributes:
        x: Columns, transposed, constant first, shape (B, c, N); rows of weight zero are zero.
        weight: Weight of each row, shape (B, N).
        degree: 1 keeps the products with the constant only.
    """

    x: Tensor
    weight: Tensor
    degree: int

    def correlations(self, v: Tensor) -> Tensor:
        """Return the weighted product of every candidate with a vector, shape (B, M).

        Args:
            v: Shape (B, N).
        """
        return sum_products(self.x, self.weight * v, self.degree)

    def energies(self) -> Tensor:
        """Return the weighted square of every candidate, shape (B, M)."""
        return sum_products(self.x.square(), self.weight, self.degree)

    def columns(self, index: Tensor) -> Tensor:
        """Return candidates, not weighted, shape (B, k, N).

        Args:
            index: Places in a table, shape (B, k).
        """
        left, right = index // self.x.shape[-2], index % self.x.shape[-2]
        return _pick(self.x, left) * _pick(self.x, right)

    def gram_rows(self, index: Tensor) -> Tensor:
        """Return the product of one candidate of each window with all others, shape (B, M).

        Args:
            index: Places in a table, shape (B,).
        """
        return self.correlations(self.columns(index.unsqueeze(-1)).squeeze(-2))


def sum_products(x: Tensor, v: Tensor, degree: int) -> Tensor:
    """Return the sum of v times every product of two columns, upper triangle, flat.

    Args:
        x: Columns, transposed, shape (c, N) or (..., c, N).
        v: Shape (..., N).
        degree: 1 for the products with the first column only.

    Returns:
        Shape (..., M), M = c², or c for degree one.
    """
    columns = x.shape[-2]
    rows = columns if degree == 2 else 1
    out = x.new_zeros(*v.shape[:-1], rows, columns)
    for a in range(0, rows, BLOCK):
        b = min(a + BLOCK, rows)
        block = x[..., a:b, :] * v.unsqueeze(-2)
        out[..., a:b, a:] = torch.matmul(block, x[..., a:, :].mT)
    return out.triu_().flatten(-2)


def _pick(x: Tensor, index: Tensor) -> Tensor:
    """Return columns by their place in each window, shape (B, k, N)."""
    return x.gather(-2, index.unsqueeze(-1).expand(*index.shape, x.shape[-1]))
