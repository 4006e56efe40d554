"""A gyro-rate error that is linear in known terms: ω_measured − ω = Σ θ_j φ_j.

The terms are fixed by physics, by FOS or by cascades; the coefficients are those of a weighted
ridge, which knows their covariance. The model has no memory.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from navlearn.error_models.gyro_terms import UNITS, GyroTerms
from navlearn.errors import ConfigError, ShapeError


@dataclass(frozen=True, kw_only=True)
class RidgeOptions:
    """Shape of a ridge model.

    Attributes:
        inputs: Number of channels m.
        terms: Names of the terms, J of them; there may be none.
        factors: Factors F of each term.
        safeguard: Clamps inputs to their training range and limits the correction.
        output_limit: Limit of the correction about its training mean, in training standard
            deviations.
    """

    inputs: int
    terms: tuple[str, ...]
    factors: int = 2
    safeguard: bool = True
    output_limit: float = 5.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms))
        for name in ("inputs", "factors"):
            if getattr(self, name) < 1:
                raise ConfigError(f"ridge: {name} is {getattr(self, name)}; expected at least 1")
        if not 0.0 < self.output_limit < math.inf:
            raise ConfigError(
                f"ridge: output_limit is {self.output_limit}; it must be positive and finite "
                "(safeguard=False takes the limit away)"
            )


def term_values(u: Tensor, form: Tensor, magnitude: Tensor) -> Tensor:
    """Return the terms at some inputs.

    Args:
        u: Channels in physical units, shape (..., m).
        form: Constant and weights of every factor, shape (J, F, m + 1).
        magnitude: 1.0 where the magnitude of a form is taken, shape (J, F).

    Returns:
        Shape (..., J).
    """
    factors = torch.einsum("...m,jfm->...jf", u, form[:, :, 1:]) + form[:, :, 0]
    factors = torch.where(magnitude > 0.5, torch.abs(factors), factors)
    return torch.prod(factors, dim=-1)


class RidgeModel(nn.Module):
    """Terms with their coefficients and safeguard; float64, scriptable, physical units.

    The output is the error of the yaw rate, rad/s. The state is empty, shape (..., 0).
    """

    def __init__(self, options: RidgeOptions) -> None:
        super().__init__()
        self.options = options
        self.memory = 0
        self.inputs = options.inputs
        self.outputs = 1
        self.safeguard = options.safeguard
        self.limit = options.output_limit if options.safeguard else math.inf
        count, m = len(options.terms), options.inputs
        zero = torch.zeros(count, dtype=torch.float64)
        self.register_buffer("form", zero.new_zeros(count, options.factors, m + 1))
        self.register_buffer("magnitude", zero.new_zeros(count, options.factors))
        self.register_buffer("coefficients", zero.clone())
        self.register_buffer("covariance", zero.new_zeros(count, count))
        self.register_buffer("u_low", zero.new_full((m,), -math.inf))
        self.register_buffer("u_high", zero.new_full((m,), math.inf))
        self.register_buffer("u_mean", zero.new_zeros(m))
        self.register_buffer("y_mean", zero.new_zeros(1))
        self.register_buffer("y_scale", zero.new_zeros(1))
        self.register_buffer("variance", zero.new_full((1,), math.inf))
        self.form: Tensor
        self.magnitude: Tensor
        self.coefficients: Tensor
        self.covariance: Tensor
        self.u_low: Tensor
        self.u_high: Tensor
        self.u_mean: Tensor
        self.y_mean: Tensor
        self.y_scale: Tensor
        self.variance: Tensor

    @torch.jit.unused
    def set_fit(
        self, terms: GyroTerms, coefficients: Tensor, covariance: Tensor, u: Tensor
    ) -> None:
        """Copy terms and coefficients in, and the range of the training data.

        Args:
            terms: The terms.
            coefficients: Shape (J,).
            covariance: Of the coefficients' error, shape (J, J).
            u: Channels in training, shape (N, m).

        Raises:
            ShapeError: There are other terms, or other channels, than the options say.
        """
        if terms.form.shape != self.form.shape or u.shape[-1] != self.inputs or len(u) == 0:
            raise ShapeError(
                f"ridge: forms have shape {tuple(terms.form.shape)} and channels "
                f"{tuple(u.shape)}; expected {tuple(self.form.shape)} and (N, {self.inputs})"
            )
        self.form.copy_(terms.form)
        self.magnitude.copy_(terms.magnitude)
        self.coefficients.copy_(coefficients)
        self.covariance.copy_(covariance)
        self.u_low.copy_(u.amin(0))
        self.u_high.copy_(u.amax(0))
        self.u_mean.copy_(u.mean(0))
        values = term_values(u, self.form, self.magnitude)
        correction = values @ self.coefficients
        self.y_mean.copy_(correction.mean())
        self.y_scale.copy_(correction.std(correction=0))
        self.variance.copy_(((values @ self.covariance) * values).sum(-1).mean())

    @torch.jit.export
    def prediction_variance(self, steps: int) -> Tensor:  # noqa: ARG002
        """Return the variance of a correction, (rad/s)², the same at every step, shape (1,).

        It is what the uncertainty of the coefficients leaves on the average of the training
        data; infinite while nothing was fitted.
        """
        return self.variance

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
    def initial_state(
        self,
        u: Tensor,
        y_start: Tensor | None = None,  # noqa: ARG002
    ) -> Tensor:
        """Return the empty state, shape (..., 0).

        Args:
            u: Inputs of the first step, shape (..., m).
            y_start: Ignored; the model has no feedback. Kept for the common contract.
        """
        return u[..., :0]

    @torch.jit.export
    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the correction of one step, and the state.

        Args:
            u: Inputs, shape (..., m).
            state: Shape (..., 0).

        Returns:
            Correction, rad/s, shape (..., 1), and the state.
        """
        values = term_values(self.guard(u), self.form, self.magnitude)
        y = (values * self.coefficients).sum(-1, keepdim=True)
        reach = self.limit * self.y_scale
        if self.safeguard:
            y = torch.minimum(torch.maximum(y, self.y_mean - reach), self.y_mean + reach)
        return y, state

    def forward(
        self,
        u: Tensor,
        y_start: Tensor | None = None,  # noqa: ARG002
    ) -> Tensor:
        """Return corrections over windows; equals ``step`` over them.

        Args:
            u: Inputs, shape (..., T, m).
            y_start: Ignored; kept for the common contract.

        Returns:
            Corrections, rad/s, shape (..., T, 1).
        """
        return self.step(u, u[..., :0])[0]

    @torch.jit.unused
    def readable_coefficients(self) -> dict[str, str]:
        """Return value, standard deviation and unit of each coefficient, by term."""
        sigma = self.covariance.diagonal().clamp(min=0.0).sqrt()
        told = {}
        for k, name in enumerate(self.options.terms):
            unit, factor = UNITS.get(name, ("SI", 1.0))
            value, spread = float(self.coefficients[k]) * factor, float(sigma[k]) * factor
            told[name] = f"{value:+.3g} ± {spread:.2g} {unit}"
        return told
