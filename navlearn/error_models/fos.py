"""FOS: a sparse polynomial of lagged inputs and outputs, ready to run.

Source: [Shen2010] §3 with [Korenberg1989]; the search is in ``fos_search``, the fit in
``fos_fit``. The model is a sum of few products of lagged channels with a constant coefficient
each, so it reads as an equation.
"""

import math
from dataclasses import asdict
from typing import Any

import torch
from torch import Tensor, nn

from navlearn.error_models.fos_candidates import Term, read_terms
from navlearn.error_models.fos_equation import name_channels, write_equation
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.scaling import Scaling, unit_scaling
from navlearn.errors import ConfigError, ShapeError


class FosModel(nn.Module):
    """A fitted polynomial; float64, scriptable, physical units.

    The state, shape (..., R, m + 1), holds the last rows of inputs and output, newest first.

    Args:
        inputs: Number of inputs m.
        terms: Chosen products, as factors of channel and lag; channel m is the output.
        options: Lags and safeguard.
    """

    def __init__(self, inputs: int, terms: tuple[Term, ...], options: FosOptions) -> None:
        super().__init__()
        self.options = options
        self.terms = terms
        self.inputs = inputs
        self.outputs = 1
        self.memory = max(options.lags, options.output_lags)
        self.feedback = any(channel == inputs for term in terms for channel, _ in term)
        self.safeguard = options.safeguard
        self.limit = options.output_limit if options.safeguard else math.inf
        places = [[0, 0] for _ in terms]
        for place, term in zip(places, terms, strict=True):
            for k, (channel, lag) in enumerate(term):
                place[k] = 1 + lag * (inputs + 1) + channel
        factors = torch.tensor(places, dtype=torch.long).reshape(-1, 2)
        self.register_buffer("left", factors[:, 0].contiguous())
        self.register_buffer("right", factors[:, 1].contiguous())
        self.coefficients = nn.Parameter(torch.zeros(len(terms), dtype=torch.float64))
        for prefix, scaling in (("u", unit_scaling(inputs)), ("y", unit_scaling(1))):
            for field, value in scaling._asdict().items():
                self.register_buffer(f"{prefix}_{field}", value)
        self.register_buffer("variance", torch.full((1, 1), torch.inf, dtype=torch.float64))
        self.left: Tensor
        self.right: Tensor
        self.u_mean: Tensor
        self.u_low: Tensor
        self.u_high: Tensor
        self.y_mean: Tensor
        self.y_scale: Tensor
        self.variance: Tensor

    @torch.jit.unused
    def set_fit(self, coefficients: Tensor, inputs: Scaling, output: Scaling) -> None:
        """Copy coefficients and the range of the training data in."""
        with torch.no_grad():
            self.coefficients.copy_(coefficients)
        for prefix, scaling in (("u", inputs), ("y", output)):
            for field, value in scaling._asdict().items():
                getattr(self, f"{prefix}_{field}").copy_(value)

    @torch.jit.unused
    def set_variance(self, variance: Tensor) -> None:
        """Keep the residual variance by steps since the start, shape (H, 1)."""
        if variance.ndim != 2 or variance.shape[1] != 1:
            raise ShapeError(f"variance has shape {tuple(variance.shape)}; expected (H, 1)")
        self.variance = variance.detach().clone()

    @torch.jit.export
    def prediction_variance(self, steps: int) -> Tensor:
        """Return the variance of an output that many steps after the start, shape (1,).

        Measured on the training data; for a model that feeds its output back, in free run.
        Beyond the longest run the last value holds.
        """
        return self.variance[max(0, min(steps, self.variance.shape[0]) - 1)]

    @torch.jit.export
    def guard(self, u: Tensor) -> Tensor:
        """Return inputs held inside their training range; NaN becomes the mean, shape (..., m)."""
        if not self.safeguard:
            return u
        return torch.where(torch.isnan(u), self.u_mean, torch.clamp(u, self.u_low, self.u_high))

    @torch.jit.export
    def count_clamped(self, u: Tensor) -> Tensor:
        """Count the inputs of each row that left the training range, shape (...)."""
        return torch.logical_not((u >= self.u_low) & (u <= self.u_high)).sum(-1)

    @torch.jit.export
    def initial_state(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return the state at the start, as if the first values had always been there.

        Args:
            u: Inputs of the first step, shape (..., m).
            y_start: Output before it, shape (..., 1); None for zero.

        Returns:
            Shape (..., R, m + 1).
        """
        if y_start is None:
            y_start = torch.zeros_like(u[..., :1])
        row = torch.cat([self.guard(u), y_start], -1).unsqueeze(-2)
        return torch.cat([row] * self.memory, -2) if self.memory > 0 else row[..., :0, :]

    @torch.jit.export
    def warm_state(self, u: Tensor, y: Tensor) -> Tensor:
        """Return the state after a record whose outputs were measured.

        Args:
            u: Inputs, shape (..., T, m).
            y: Measured outputs, shape (..., T, 1).

        Returns:
            Shape (..., R, m + 1).
        """
        rows = torch.cat([self.guard(u), y], -1).flip(-2)
        state = self.initial_state(u[..., 0, :], y[..., 0, :])
        return torch.cat([rows, state], -2)[..., : self.memory, :]

    @torch.jit.export
    def evaluate(self, window: Tensor) -> Tensor:
        """Return the limited sum of the terms, shape (..., 1).

        Args:
            window: Rows of inputs and output, newest first, shape (..., R + 1, m + 1).
        """
        flat = window.flatten(-2)
        flat = torch.cat([torch.ones_like(flat[..., :1]), flat], -1)
        products = flat.index_select(-1, self.left) * flat.index_select(-1, self.right)
        y = (products * self.coefficients).sum(-1, keepdim=True)
        reach = self.limit * self.y_scale
        return torch.minimum(torch.maximum(y, self.y_mean - reach), self.y_mean + reach)

    @torch.jit.export
    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the output after one step, and the next state.

        Args:
            u: Inputs of the step, shape (..., m).
            state: Shape (..., R, m + 1), from ``initial_state`` or ``warm_state``.

        Returns:
            Output of shape (..., 1), and the state.
        """
        now = self.guard(u)
        blank = torch.cat([now, torch.zeros_like(now[..., :1])], -1).unsqueeze(-2)
        y = self.evaluate(torch.cat([blank, state], -2))
        row = torch.cat([now, y], -1).unsqueeze(-2)
        return y, torch.cat([row, state], -2)[..., : self.memory, :]

    @torch.jit.export
    def run(self, u: Tensor, state: Tensor) -> Tensor:
        """Run over windows from a state, on the model's own output where it is fed back.

        Args:
            u: Inputs, shape (..., T, m).
            state: Shape (..., R, m + 1).

        Returns:
            Outputs, shape (..., T, 1).
        """
        if u.shape[-2] == 0:
            return torch.zeros_like(u[..., :1])
        if not self.feedback:
            now = self.guard(u)
            rows = torch.cat([now, torch.zeros_like(now[..., :1])], -1)
            record = torch.cat([state.flip(-2), rows], -2)
            windows = record.unfold(-2, self.memory + 1, 1)
            return self.evaluate(windows.flip(-1).transpose(-1, -2))
        outputs: list[Tensor] = []
        for row in u.unbind(-2):
            y, state = self.step(row, state)
            outputs.append(y)
        return torch.stack(outputs, -2)

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Run over windows; equals ``step`` over them.

        Args:
            u: Inputs, shape (..., T, m), T at least 1.
            y_start: Output before the first row, shape (..., 1); None for zero.

        Returns:
            Outputs, shape (..., T, 1).
        """
        return self.run(u, self.initial_state(u[..., 0, :], y_start))

    @torch.jit.unused
    def equation(
        self,
        names: tuple[str, ...] = (),
        output: str = "y",
        units: tuple[str, ...] = (),
        output_unit: str = "",
    ) -> str:
        """Return the model as an equation, with the unit of each coefficient.

        Args:
            names: Names of the inputs, in order; none for u1, u2, ...
            output: Name of the output.
            units: Units of the inputs, in order; none to write no units.
            output_unit: Unit of the output.

        Raises:
            ConfigError: The names or units are not as many as the inputs.
        """
        channels = name_channels(self.inputs, names, output, units, output_unit)
        return write_equation(self.coefficients.tolist(), self.terms, *channels)


def fos_description(model: FosModel) -> dict[str, Any]:
    """Return what a reader needs beside the weights, as plain lists, numbers and words.

    Args:
        model: A fitted model.
    """
    terms = [[list(factor) for factor in term] for term in model.terms]
    return {"inputs": model.inputs, "terms": terms, "options": asdict(model.options)}


def fos_from_description(description: dict[str, Any], weights: dict[str, Tensor]) -> FosModel:
    """Return a model from its description and its ``state_dict``; predicts as the saved one did.

    Args:
        description: From ``fos_description``, after JSON or not.
        weights: The model's ``state_dict``.

    Raises:
        ConfigError: The description is none, or the weights belong to another model.
    """
    try:
        inputs, options = int(description["inputs"]), FosOptions(**description["options"])
        model = FosModel(inputs, read_terms(description["terms"], inputs, options), options)
        places = [model.left.tolist(), model.right.tolist()]
        model.set_variance(weights["variance"])
        model.load_state_dict(weights)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ConfigError(
            f"fos: no model can be built ({type(error).__name__}: {error}); give inputs, terms "
            "and options from fos_description and the weights of the same model"
        ) from error
    if [model.left.tolist(), model.right.tolist()] != places:
        raise ConfigError("fos: the weights hold other terms than the description")
    return model.eval()
