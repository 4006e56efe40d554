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
    """Return X transposed, for the rows that have a whole past.

    Args:
        u: Inputs, shape (..., T, m).
        y: Output, shape (..., T).
        options: Lags.

    Returns:
        Shape (c, rows), rows of all windows after one another, T − memory of each.

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
    channels = [*u.double().unbind(-1), y.double()]
    rows = y[..., memory:].numel()
    columns = factor_list(u.shape[-1], options)
    x = torch.ones(len(columns), rows, dtype=torch.float64)
    for row, column in zip(x[1:], columns[1:], strict=True):
        (channel, lag) = column[0]
        row.copy_(channels[channel][..., memory - lag : steps - lag].reshape(-1))
    return x


@dataclass(frozen=True)
class Candidates:
    """Products of two columns, weighted; element (i, j), i ≤ j, of a table is one candidate.

    Attributes:
        x: Columns over their scale, transposed, shape (c, N).
        scale: Root mean square of each column, shape (c,).
        root_weight: Square root of the weight of each row, shape (N,).
        degree: 1 keeps the products with the constant only.
    """

    x: Tensor
    scale: Tensor
    root_weight: Tensor
    degree: int

    @property
    def rows(self) -> int:
        """Rows of a table: c, or 1 for degree one."""
        return self.x.shape[0] if self.degree == 2 else 1

    def correlations(self, v: Tensor) -> Tensor:
        """Return the product of every weighted candidate with a vector, shape (rows, c).

        Args:
            v: Shape (N,).
        """
        return _blockwise(self.x, self.root_weight * v, self.rows)

    def energies(self) -> Tensor:
        """Return the squared norm of every weighted candidate, shape (rows, c)."""
        return _blockwise(self.x.square(), self.root_weight.square(), self.rows)

    def column(self, index: tuple[int, int]) -> Tensor:
        """Return one weighted candidate, shape (N,)."""
        return self.root_weight * self.x[index[0]] * self.x[index[1]]

    def unit(self, index: tuple[int, int]) -> float:
        """Return what a candidate was divided by."""
        return float(self.scale[index[0]] * self.scale[index[1]])


def build_candidates(x: Tensor, weight: Tensor, degree: int) -> Candidates:
    """Return the candidates over scaled columns; ``x`` is scaled in place.

    Args:
        x: Columns, transposed, constant first, shape (c, N).
        weight: Weight of each row, shape (N,).
        degree: Largest degree, 1 or 2.
    """
    scale = torch.stack([row.square().mean().sqrt() for row in x])
    scale = torch.where(scale > 0, scale, 1.0)
    return Candidates(x.div_(scale.unsqueeze(1)), scale, weight.sqrt(), degree)


def _blockwise(x: Tensor, v: Tensor, rows: int) -> Tensor:
    """Return the upper triangle of x diag(v) xᵀ, zero below, by blocks of its rows."""
    out = x.new_zeros(rows, x.shape[0])
    for a in range(0, rows, BLOCK):
        b = min(a + BLOCK, rows)
        torch.matmul(x[a:b] * v, x[a:].T, out=out[a:b, a:])
    return out.triu_()
