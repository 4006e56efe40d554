"""The module that is exported: a model behind four methods, with its metadata inside."""

import json
from typing import Any

import torch
from torch import Tensor, nn


class Predictor(nn.Module):
    """An error model as others see it; physical units in and out, float64.

    Inputs of another shape are refused with what was expected.

    Attributes:
        metadata: JSON text of :class:`navlearn.export.metadata.PredictorMetadata`.
    """

    def __init__(self, model: nn.Module, metadata: str) -> None:
        super().__init__()
        about: dict[str, Any] = json.loads(metadata)
        self.channels = len(about["inputs"])
        self.channel_names = ", ".join(about["inputs"])
        # Any: TorchScript compiles the calls against the model that it finds.
        self.model: Any = model
        self.metadata = metadata

    @torch.jit.export
    def initial_state(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return the state before the first step.

        Args:
            u: Inputs of the first step, shape (..., m).
            y_start: Output before it, shape (..., p); None for zero.
        """
        self._refuse_wrong_shape(u, 1)
        state: Tensor = self.model.initial_state(u, y_start)
        return state

    @torch.jit.export
    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the correction of one step and the next state.

        Args:
            u: Inputs, shape (..., m).
            state: From :meth:`initial_state` or the step before.

        Returns:
            Correction, shape (..., p), and the state.
        """
        self._refuse_wrong_shape(u, 1)
        correction: tuple[Tensor, Tensor] = self.model.step(u, state)
        return correction

    @torch.jit.export
    def prediction_variance(self, steps: int) -> Tensor:
        """Return the variance of a correction that many steps after the start, shape (p,)."""
        variance: Tensor = self.model.prediction_variance(steps)
        return variance

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return the corrections over windows; the same as steps over them.

        Args:
            u: Inputs, shape (..., T, m).
            y_start: Output before the first row, shape (..., p); None for zero.

        Returns:
            Corrections, shape (..., T, p).
        """
        self._refuse_wrong_shape(u, 2)
        corrections: Tensor = self.model.forward(u, y_start)
        return corrections

    def _refuse_wrong_shape(self, u: Tensor, axes: int) -> None:
        if u.dim() < axes or u.size(-1) != self.channels:
            rows = "(..., T, " if axes == 2 else "(..., "
            raise ValueError(
                f"inputs have shape {u.shape}; expected {rows}{self.channels}) with the columns "
                f"{self.channel_names}"
            )


class ScannedWindow(nn.Module):
    """Windowed prediction as a scan over time, which ``torch.export`` keeps for any length."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model: Any = model

    def forward(self, u: Tensor) -> Tensor:
        """Return the corrections over windows.

        Args:
            u: Inputs, shape (B, T, m).

        Returns:
            Corrections, shape (B, T, p).
        """
        # An experimental operator of torch: the only one by which time stays dynamic.
        from torch._higher_order_ops.scan import scan

        # The scan insists on one layout of its state; models hand on views of longer windows.
        def dense(state: Tensor) -> Tensor:
            return state.clone(memory_format=torch.contiguous_format)

        def advance(state: Tensor, row: Tensor) -> tuple[Tensor, Tensor]:
            y, following = self.model.step(row, state)
            return dense(following), y

        _, corrections = scan(advance, dense(self.model.initial_state(u[:, 0])), u, dim=1)
        result: Tensor = corrections
        return result
