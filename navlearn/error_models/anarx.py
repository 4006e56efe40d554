"""ANARX: an additive nonlinear autoregressive network with exogenous inputs.

Source: [Jaradat2017] with the structure of [Petlenkov2006]; the mathematics is in
``anarx_core``. The network runs on its own output through an outage (``step``, ``forward``) and
one step ahead on measured outputs while fixes are there (``open_loop``).

The paper's network is ``AnarxOptions(activation="sigmoid", linear_path=False, safeguard=False)``
with the number of steps since the last fix among its inputs.
"""

import math

import torch
from torch import Tensor, nn

from navlearn.error_models.anarx_core import (
    AnarxWeights,
    advance,
    forced_state,
    free_run,
    held_rows,
    held_state,
    one_step_ahead,
)
from navlearn.error_models.anarx_options import AnarxOptions
from navlearn.error_models.safeguard import clamp_and_standardise, count_outside
from navlearn.error_models.scaling import Scaling, unit_scaling
from navlearn.errors import ShapeError

__all__ = ["Anarx", "AnarxOptions"]


class Anarx(nn.Module):
    """The network with its scaling and safeguards inside; float64, scriptable.

    Inputs and outputs are in physical units. The state, shape (..., n, p), is in standardised
    units: the last output, then the partial sums of the later lags.
    """

    def __init__(self, options: AnarxOptions) -> None:
        super().__init__()
        n, h, p = options.lags, options.hidden, options.outputs
        q = p + options.inputs
        self.options = options
        self.memory = n
        self.inputs = options.inputs
        self.outputs = p
        self.sigmoid = options.activation == "sigmoid"
        self.safeguard = options.safeguard
        self.limit = options.output_limit if options.safeguard else math.inf
        zeros = torch.zeros
        self.weight = nn.Parameter(zeros(n, h, q, dtype=torch.float64))
        self.bias = nn.Parameter(zeros(n, h, dtype=torch.float64))
        self.out = nn.Parameter(zeros(n, p, h, dtype=torch.float64))
        self.linear = nn.Parameter(
            zeros(n, p, q, dtype=torch.float64), requires_grad=options.linear_path
        )
        self.offset = nn.Parameter(zeros(p, dtype=torch.float64))
        for prefix, scaling in (("u", unit_scaling(options.inputs)), ("y", unit_scaling(p))):
            for field, value in scaling._asdict().items():
                self.register_buffer(f"{prefix}_{field}", value)
        self.register_buffer("variance", torch.full((1, p), torch.inf, dtype=torch.float64))
        self.u_mean: Tensor
        self.u_scale: Tensor
        self.u_low: Tensor
        self.u_high: Tensor
        self.y_mean: Tensor
        self.y_scale: Tensor
        self.variance: Tensor

    @torch.jit.export
    def weights(self) -> AnarxWeights:
        """Return the weights, in standardised units."""
        return AnarxWeights(self.weight, self.bias, self.out, self.linear, self.offset)

    @torch.jit.unused
    def set_weights(self, w: AnarxWeights) -> None:
        """Copy weights in, as a fitter found them."""
        with torch.no_grad():
            for name, value in w._asdict().items():
                getattr(self, name).copy_(value)

    @torch.jit.unused
    def set_scaling(self, inputs: Scaling, outputs: Scaling) -> None:
        """Copy the scaling of regressors and targets in."""
        for prefix, scaling in (("u", inputs), ("y", outputs)):
            for field, value in scaling._asdict().items():
                getattr(self, f"{prefix}_{field}").copy_(value)

    @torch.jit.unused
    def set_variance(self, variance: Tensor) -> None:
        """Keep the residual variance by steps since the start, shape (H, p)."""
        if variance.ndim != 2 or variance.shape[1] != self.outputs:
            raise ShapeError(
                f"variance has shape {tuple(variance.shape)}; expected (H, {self.outputs})"
            )
        self.variance = variance.detach().clone()

    @torch.jit.export
    def prediction_variance(self, steps: int) -> Tensor:
        """Return the variance of an output that many steps after the start, shape (p,).

        It was measured on validation windows run in closed loop; beyond the longest of them the
        last value holds. Infinite while nothing was measured.
        """
        return self.variance[max(0, min(steps, self.variance.shape[0]) - 1)]

    @torch.jit.export
    def standardise_inputs(self, u: Tensor) -> Tensor:
        """Return inputs in standardised units, safeguarded, shape (..., m)."""
        if self.safeguard:
            return clamp_and_standardise(u, self.u_low, self.u_high, self.u_mean, self.u_scale)
        return (u - self.u_mean) / self.u_scale

    @torch.jit.export
    def standardise_outputs(self, y: Tensor) -> Tensor:
        """Return outputs in standardised units, shape (..., p)."""
        return (y - self.y_mean) / self.y_scale

    @torch.jit.export
    def count_clamped(self, u: Tensor) -> Tensor:
        """Count the inputs of each row that left the training range, shape (...)."""
        return count_outside(u, self.u_low, self.u_high)

    @torch.jit.export
    def count_limited(self, y: Tensor) -> Tensor:
        """Count the outputs of each row that stand at their limit, shape (...)."""
        reach = self.standardise_outputs(y).abs() * (1.0 + 1e-12)
        return (reach >= self.limit).sum(-1)

    @torch.jit.export
    def initial_state(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return the state at the start, as if the first values had always been there.

        Args:
            u: Inputs of the first step, shape (..., m).
            y_start: Output before it, shape (..., p); None for zero.

        Returns:
            Shape (..., n, p).
        """
        if y_start is None:
            y_start = torch.zeros_like(u[..., :1]) * self.y_mean
        y = self.standardise_outputs(y_start)
        return held_state(self.weights(), self.sigmoid, y, self.standardise_inputs(u))

    @torch.jit.export
    def warm_state(self, u: Tensor, y: Tensor, y_start: Tensor) -> Tensor:
        """Return the state after a record whose outputs were measured.

        Args:
            u: Inputs, shape (..., T, m).
            y: Measured outputs, shape (..., T, p).
            y_start: Output before the first row, shape (..., p).

        Returns:
            Shape (..., n, p).
        """
        measured = self.standardise_outputs(y)
        before, inputs = held_rows(
            self.standardise_inputs(u), measured, self.standardise_outputs(y_start), self.memory
        )
        start = before.shape[-2] - self.memory + 1
        return forced_state(
            self.weights(),
            self.sigmoid,
            before[..., start:, :],
            inputs[..., start:, :],
            measured[..., -1, :],
        )

    @torch.jit.export
    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the output after one step, and the next state.

        Args:
            u: Inputs of the step, shape (..., m).
            state: Shape (..., n, p), from ``initial_state`` or ``warm_state``.

        Returns:
            Output of shape (..., p), and the state.
        """
        y, state = advance(
            self.weights(), self.sigmoid, self.limit, state, self.standardise_inputs(u)
        )
        return torch.addcmul(self.y_mean, self.y_scale, y), state

    @torch.jit.export
    def run(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Run on the network's own output from a state.

        Args:
            u: Inputs, shape (..., T, m).
            state: Shape (..., n, p).

        Returns:
            Outputs of shape (..., T, p), and the state after the last row.
        """
        shaped = torch.zeros_like(u[..., :1]) * self.y_mean
        if u.shape[-2] == 0:
            return shaped, state
        start = torch.zeros_like(u[..., :1, :1]) + state
        y, last = free_run(
            self.weights(),
            self.sigmoid,
            self.limit,
            self.standardise_inputs(u).reshape(-1, u.shape[-2], self.inputs),
            start.reshape(-1, self.memory, self.outputs),
        )
        return torch.addcmul(self.y_mean, self.y_scale, y.view_as(shaped)), last.view_as(start)

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Run in closed loop over windows.

        Args:
            u: Inputs, shape (..., T, m).
            y_start: Output before the first row, shape (..., p); None for zero.

        Returns:
            Outputs, shape (..., T, p).
        """
        y, _ = self.run(u, self.initial_state(u[..., 0, :], y_start))
        return y

    @torch.jit.export
    def open_loop(self, u: Tensor, y: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Predict every row from the measured outputs before it, in parallel over time.

        Args:
            u: Inputs, shape (..., T, m).
            y: Measured outputs, shape (..., T, p).
            y_start: Output before the first row, shape (..., p); None for zero.

        Returns:
            Predictions, shape (..., T, p).
        """
        if y_start is None:
            y_start = torch.zeros_like(y[..., 0, :])
        before, inputs = held_rows(
            self.standardise_inputs(u),
            self.standardise_outputs(y),
            self.standardise_outputs(y_start),
            self.memory,
        )
        ahead = one_step_ahead(self.weights(), self.sigmoid, before, inputs)
        return self.y_mean + self.y_scale * torch.clamp(ahead, -self.limit, self.limit)
