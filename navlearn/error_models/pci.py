"""Parallel cascades: sums of linear elements, each followed by a static polynomial.

Source: [Iqbal2020, IV] after [Korenberg1991]. The model has no feedback: an output depends on
the last R + 1 inputs alone. ``pci_fit`` builds it from data.
"""

import math

import torch
from torch import Tensor, nn

from navlearn.error_models.fos_equation import name_channels
from navlearn.error_models.pci_candidates import Cascades, basis
from navlearn.error_models.pci_equation import (
    PhysicalCascades,
    physical_cascades,
    write_cascades,
)
from navlearn.error_models.pci_options import PciOptions
from navlearn.error_models.safeguard import clamp_and_standardise, count_outside
from navlearn.error_models.scaling import Scaling, unit_scaling

__all__ = ["PciModel", "PciOptions"]


class PciModel(nn.Module):
    """Cascades with their scaling and safeguards inside; float64, scriptable.

    Inputs and output are in physical units. The state, shape (..., R, m), holds the last R
    inputs in standardised units, the newest last. Without cascades the output is the mean.
    """

    def __init__(self, options: PciOptions) -> None:
        super().__init__()
        m, depth, degree = options.inputs, options.lags + 1, options.degree
        self.options = options
        self.memory = depth
        self.inputs = m
        self.safeguard = options.safeguard
        self.limit = options.output_limit if options.safeguard else math.inf
        for prefix, scaling in (("u", unit_scaling(m)), ("y", unit_scaling(1))):
            for field, value in scaling._asdict().items():
                self.register_buffer(f"{prefix}_{field}", value)
        none = torch.zeros(0, dtype=torch.float64)
        self.register_buffer("response", none.reshape(0, depth, m))
        self.register_buffer("shift", none.reshape(0, degree))
        self.register_buffer("norm", none.reshape(0, degree))
        self.register_buffer("weight", none.reshape(0, degree + 1))
        self.register_buffer("low", none.clone())
        self.register_buffer("high", none.clone())
        self.register_buffer("variance", torch.full((1,), torch.inf, dtype=torch.float64))
        self.u_mean: Tensor
        self.u_scale: Tensor
        self.u_low: Tensor
        self.u_high: Tensor
        self.y_mean: Tensor
        self.y_scale: Tensor
        self.response: Tensor
        self.shift: Tensor
        self.norm: Tensor
        self.weight: Tensor
        self.low: Tensor
        self.high: Tensor
        self.variance: Tensor

    @torch.jit.unused
    def set_cascades(self, cascades: Cascades) -> None:
        """Copy cascades in, responses of shape (K, (R + 1) m) by lag, then channel."""
        count = cascades.response.shape[0]
        shaped = cascades._replace(
            response=cascades.response.reshape(count, self.memory, self.inputs)
        )
        for field, value in shaped._asdict().items():
            setattr(self, field, value.detach().clone())

    @torch.jit.unused
    def set_scaling(self, inputs: Scaling, outputs: Scaling) -> None:
        """Copy the scaling of regressors and target in."""
        for prefix, scaling in (("u", inputs), ("y", outputs)):
            for field, value in scaling._asdict().items():
                getattr(self, f"{prefix}_{field}").copy_(value)

    @torch.jit.export
    def prediction_variance(self, steps: int) -> Tensor:  # noqa: ARG002
        """Return the variance of an output, the same at every step, shape (1,).

        It is the training residual's, divided by the rows left after what was fitted together;
        infinite while nothing was fitted.
        """
        return self.variance

    @torch.jit.export
    def standardise_inputs(self, u: Tensor) -> Tensor:
        """Return inputs in standardised units, safeguarded, shape (..., m)."""
        if self.safeguard:
            return clamp_and_standardise(u, self.u_low, self.u_high, self.u_mean, self.u_scale)
        return (u - self.u_mean) / self.u_scale

    @torch.jit.export
    def count_clamped(self, u: Tensor) -> Tensor:
        """Count the inputs of each row that left the training range, shape (...)."""
        return count_outside(u, self.u_low, self.u_high)

    @torch.jit.export
    def respond(self, windows: Tensor) -> Tensor:
        """Return the output for standardised windows (..., R + 1, m), the newest row last."""
        linear = torch.einsum("...lm,klm->...k", windows, self.response.flip(1))
        if self.safeguard:
            linear = torch.clamp(linear, self.low, self.high)
        values = basis(linear, self.shift, self.norm)
        y = (values * self.weight).sum(-1).sum(-1, keepdim=True)
        return torch.addcmul(self.y_mean, self.y_scale, torch.clamp(y, -self.limit, self.limit))

    @torch.jit.export
    def initial_state(
        self,
        u: Tensor,
        y_start: Tensor | None = None,  # noqa: ARG002
    ) -> Tensor:
        """Return the state at the start, as if the first inputs had always been there.

        Args:
            u: Inputs of the first step, shape (..., m).
            y_start: Ignored; the model has no feedback. Kept for the common contract.

        Returns:
            Shape (..., R, m).
        """
        return torch.stack([self.standardise_inputs(u)] * self.memory, -2)[..., 1:, :]

    @torch.jit.export
    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the output after one step, and the next state.

        Args:
            u: Inputs of the step, shape (..., m).
            state: Shape (..., R, m).

        Returns:
            Output of shape (..., 1), and the state.
        """
        window = torch.cat((state, self.standardise_inputs(u).unsqueeze(-2)), -2)
        return self.respond(window), window[..., 1:, :]

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return outputs over windows; the inputs before the first row are held at it.

        Args:
            u: Inputs, shape (..., T, m).
            y_start: Ignored; the model has no feedback. Kept for the common contract.

        Returns:
            Outputs, shape (..., T, 1).
        """
        if u.shape[-2] == 0:
            return torch.zeros_like(u[..., :1]) * self.y_mean
        start = self.initial_state(u[..., 0, :], y_start)
        rows = torch.cat((start, self.standardise_inputs(u)), -2)
        return self.respond(rows.unfold(-2, self.memory, 1).transpose(-1, -2))

    @torch.jit.unused
    def physical(self) -> PhysicalCascades:
        """Return the cascades in physical units."""
        cascades = Cascades(*(getattr(self, name) for name in Cascades._fields))
        scalings = (
            Scaling(*(getattr(self, f"{prefix}_{name}") for name in Scaling._fields))
            for prefix in ("u", "y")
        )
        return physical_cascades(cascades, *scalings)

    @torch.jit.unused
    def equation(
        self,
        names: tuple[str, ...] = (),
        output: str = "y",
        units: tuple[str, ...] = (),
        output_unit: str = "",
    ) -> str:
        """Return the model as equations: the sum, each polynomial, each linear response.

        Args:
            names: Names of the inputs, in order; none for u1, u2, ...
            output: Name of the output.
            units: Units of the inputs, in order; none to write no units.
            output_unit: Unit of the output.

        Raises:
            ConfigError: The names or units are not as many as the inputs.
        """
        channels = name_channels(self.inputs, names, output, units, output_unit)
        return write_cascades(self.physical(), *channels)
