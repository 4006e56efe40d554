"""Training an ANARX network by Adam as a Lightning module.

The loss is that of the free run over several steps (or of one step ahead); its horizon may
grow from a few rows to the whole window, which steadies the first epochs.
"""

import torch
from lightning.pytorch import LightningModule
from torch import Tensor
from typing_extensions import override

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.anarx_jacobian import pack_weights
from navlearn.learning.anarx_least_squares import PaddedWindows, residuals
from navlearn.learning.options import TrainingOptions


class AnarxTask(LightningModule):
    """An ANARX network with its loss and optimiser.

    Args:
        model: Network with its scaling set.
        training: Options.
        rows: Rows of a window.
    """

    def __init__(self, model: Anarx, training: TrainingOptions, rows: int) -> None:
        super().__init__()
        self.model = model
        self.training_options = training
        self.rows = rows

    def horizon(self, epoch: int) -> int:
        """Return the rows that are scored at an epoch."""
        training = self.training_options
        if training.first_horizon == 0 or epoch >= training.horizon_epochs:
            return self.rows
        share = epoch / training.horizon_epochs
        grown = training.first_horizon + share * (self.rows - training.first_horizon)
        return max(1, min(self.rows, round(grown)))

    def mean_square(self, batch: PaddedWindows) -> Tensor:
        """Return the weighted mean square residual of a batch."""
        training = self.training_options
        residual = residuals(
            self.model.weights(),
            self.model.sigmoid,
            batch,
            closed=training.loop == "closed",
            accumulate=training.objective == "accumulated",
        )
        weight = batch.weight.unsqueeze(-1)
        return (weight * residual**2).sum() / (batch.weight.sum() * residual.shape[-1])

    @override
    def training_step(self, batch: PaddedWindows, batch_index: int) -> Tensor:
        """Return the loss of a batch, ridge included."""
        rows = self.horizon(self.current_epoch)
        padding = self.model.memory - 1
        shortened = PaddedWindows(
            batch.before[:, : rows + padding],
            batch.u[:, : rows + padding],
            batch.y[:, :rows],
            batch.weight[:, :rows],
        )
        if not bool((shortened.weight > 0).any()):
            shortened = batch
        loss = self.mean_square(shortened)
        self.log("train", loss, on_step=False, on_epoch=True, batch_size=batch.u.shape[0])
        theta = pack_weights(self.model.weights(), self.model.options.linear_path)
        return loss + self.training_options.ridge * theta @ theta

    @override
    def validation_step(self, batch: PaddedWindows, batch_index: int) -> None:
        """Log the loss over the whole horizon."""
        self.log("valid", self.mean_square(batch), batch_size=batch.u.shape[0])

    @override
    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Return Adam over the weights that are trained."""
        trained = [p for p in self.model.parameters() if p.requires_grad]
        return torch.optim.Adam(trained, lr=self.training_options.learning_rate)
