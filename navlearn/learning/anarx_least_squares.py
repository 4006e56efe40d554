"""Fitting an ANARX network as a least-squares problem, in open and in closed loop.

The normal equations are summed block by block, so that a Jacobian is never larger than a stated
number of bytes. Everything is in standardised units.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.anarx_core import (
    AnarxWeights,
    forced_state,
    free_run,
    held_rows,
    one_step_ahead,
)
from navlearn.error_models.anarx_jacobian import (
    closed_loop_jacobian,
    one_step_jacobian,
    unpack_weights,
)
from navlearn.learning.levenberg_marquardt import NormalEquations
from navlearn.learning.windows import Windows

BLOCK_BYTES = 8_000_000


class PaddedWindows(NamedTuple):
    """Standardised windows, lengthened to the front by the lags.

    Attributes:
        before: Measured output before each row, shape (N, T + n − 1, p).
        u: Inputs of each row, shape (N, T + n − 1, m).
        y: Targets, shape (N, T, p).
        weight: Weight of each row, shape (N, T).
    """

    before: Tensor
    u: Tensor
    y: Tensor
    weight: Tensor


def pad_windows(model: Anarx, windows: Windows) -> PaddedWindows:
    """Standardise windows with the model's scaling and drop their warm-up rows.

    Args:
        model: Network with its scaling set.
        windows: Checked windows; the warm-up only sets what precedes the first row.
    """
    y_start = windows.y_start if windows.y_start is not None else windows.y[:, 0] * 0.0
    y = model.standardise_outputs(windows.y)
    before, u = held_rows(
        model.standardise_inputs(windows.u), y, model.standardise_outputs(y_start), model.memory
    )
    skip = windows.warmup
    return PaddedWindows(before[:, skip:], u[:, skip:], y[:, skip:], windows.weight[:, skip:])


def run_padded(w: AnarxWeights, sigmoid: bool, data: PaddedWindows) -> Tensor:
    """Return the free run over padded windows, shape (N, T, p), without the output limit."""
    n = w.weight.shape[0]
    start = forced_state(
        w, sigmoid, data.before[:, : n - 1], data.u[:, : n - 1], data.before[:, n - 1]
    )
    y, _ = free_run(w, sigmoid, float("inf"), data.u[:, n - 1 :], start)
    return y


def residuals(
    w: AnarxWeights, sigmoid: bool, data: PaddedWindows, *, closed: bool, accumulate: bool
) -> Tensor:
    """Return prediction minus target, shape (N, T, p).

    Args:
        w: Weights.
        sigmoid: Activation.
        data: Padded windows.
        closed: True for the free run, False for one step ahead.
        accumulate: True for the running sum of the residuals over each window.
    """
    predicted = (
        run_padded(w, sigmoid, data) if closed else one_step_ahead(w, sigmoid, data.before, data.u)
    )
    residual = predicted - data.y
    return residual.cumsum(1) if accumulate else residual


class AnarxLeastSquares:
    """½ Σ w r² of an ANARX network over windows, as a problem in its packed weights.

    Args:
        model: Network that gives shapes, activation and scaling; its weights are not read.
        windows: Checked windows.
        closed: True for the free run, False for one step ahead.
        accumulate: True for residuals summed over the window so far (closed loop only).
        block_bytes: Largest Jacobian held at a time.
    """

    def __init__(
        self,
        model: Anarx,
        windows: Windows,
        *,
        closed: bool,
        accumulate: bool = False,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        self.data = pad_windows(model, windows)
        self.like = AnarxWeights(*(part.detach() for part in model.weights()))
        self.sigmoid = model.sigmoid
        self.linear_path = model.options.linear_path
        self.closed = closed
        self.accumulate = accumulate
        self.block_bytes = block_bytes

    def residuals(self, theta: Tensor) -> Tensor:
        """Return all residuals, shape (N, T, p)."""
        w = unpack_weights(theta, self.like, self.linear_path)
        return residuals(w, self.sigmoid, self.data, closed=self.closed, accumulate=self.accumulate)

    def cost(self, theta: Tensor) -> float:
        """Return ½ Σ w r²."""
        r = self.residuals(theta)
        return 0.5 * float((self.data.weight.unsqueeze(-1) * r * r).sum())

    def mean_square(self, theta: Tensor) -> float:
        """Return the weighted mean of r² over rows and outputs."""
        total = float(self.data.weight.sum()) * self.data.y.shape[-1]
        return 2.0 * self.cost(theta) / total

    def normal_equations(self, theta: Tensor) -> NormalEquations:
        """Return cost, gram and gradient, summed over blocks."""
        w = unpack_weights(theta, self.like, self.linear_path)
        size = theta.shape[0]
        gram, gradient = theta.new_zeros(size, size), theta.new_zeros(size)
        cost = 0.0
        for block in self._blocks(size):
            jacobian, residual = self._linearise(w, block)
            root = block.weight.sqrt()[..., None]
            residual = (residual * root).reshape(-1)
            jacobian = jacobian.mul_(root.unsqueeze(-1)).reshape(-1, size)
            gram.addmm_(jacobian.t(), jacobian)
            gradient.addmv_(jacobian.t(), residual)
            cost += 0.5 * float(residual @ residual)
        return NormalEquations(cost, gram, gradient)

    def _linearise(self, w: AnarxWeights, block: PaddedWindows) -> tuple[Tensor, Tensor]:
        """Return Jacobian (N, T, p, P) and residual (N, T, p) of a block."""
        n = w.weight.shape[0]
        if not self.closed:
            predicted = one_step_ahead(w, self.sigmoid, block.before, block.u)
            jacobian = one_step_jacobian(w, self.sigmoid, self.linear_path, block.before, block.u)
            return jacobian, predicted - block.y
        predicted = run_padded(w, self.sigmoid, block)
        before = torch.cat([block.before[:, :n], predicted[:, :-1]], 1)
        jacobian = closed_loop_jacobian(w, self.sigmoid, self.linear_path, before, block.u)
        residual = predicted - block.y
        if self.accumulate:
            return jacobian.cumsum(1), residual.cumsum(1)
        return jacobian, residual

    def _blocks(self, size: int) -> list[PaddedWindows]:
        """Return the data in blocks of whole windows, or of rows where one step ahead allows."""
        data, lags = self.data, self.like.weight.shape[0]
        count, rows, outputs = data.y.shape
        most = max(1, self.block_bytes // (8 * outputs * size))
        windows = max(1, most // rows)
        blocks = [
            PaddedWindows(*(part[k : k + windows] for part in data))
            for k in range(0, count, windows)
        ]
        if self.closed or rows <= most:
            return blocks
        return [
            PaddedWindows(
                b.before[:, k : k + most + lags - 1],
                b.u[:, k : k + most + lags - 1],
                b.y[:, k : k + most],
                b.weight[:, k : k + most],
            )
            for b in blocks
            for k in range(0, rows, most)
        ]
