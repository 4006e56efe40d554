"""Windows as batches for Lightning, in an order that depends on seed and epoch alone.

Windows are a few megabytes of tensors: batches are slices of them, without workers. The order
of an epoch is drawn anew from (seed, epoch), so training that was interrupted meets the batches
that it would have met.
"""

from collections.abc import Iterator

import torch
from lightning.pytorch import LightningDataModule
from torch import Tensor

from navlearn.learning.anarx_least_squares import PaddedWindows


class WindowBatches:
    """Batches of windows; an iterable with a length.

    Args:
        windows: Padded windows.
        batch_size: Windows per batch; 0 takes all at once.
        order: Order of the windows, shape (N,); None keeps it.
    """

    def __init__(
        self, windows: PaddedWindows, batch_size: int, order: Tensor | None = None
    ) -> None:
        self.windows = windows
        self.order = order
        self.batch_size = batch_size or windows.u.shape[0]

    def __len__(self) -> int:
        """Return the number of batches."""
        return -(-self.windows.u.shape[0] // self.batch_size)

    def __iter__(self) -> Iterator[PaddedWindows]:
        """Yield batches."""
        order = torch.arange(self.windows.u.shape[0]) if self.order is None else self.order
        for first in range(0, order.shape[0], self.batch_size):
            index = order[first : first + self.batch_size]
            yield PaddedWindows(*(part[index] for part in self.windows))


class WindowDataModule(LightningDataModule):
    """Training and validation windows.

    The trainer must reload the training batches at every epoch.

    Args:
        train: Padded training windows.
        valid: Padded validation windows, or None.
        batch_size: Windows per batch; 0 takes all at once.
        seed: Seed of the order.
    """

    def __init__(
        self, train: PaddedWindows, valid: PaddedWindows | None, *, batch_size: int, seed: int
    ) -> None:
        super().__init__()
        self.train_windows, self.valid_windows = train, valid
        self.batch_size, self.seed = batch_size, seed

    def train_dataloader(self) -> WindowBatches:
        """Return the training batches of the present epoch."""
        epoch = self.trainer.current_epoch if self.trainer is not None else 0
        generator = torch.Generator().manual_seed(1_000_003 * self.seed + epoch)
        order = torch.randperm(self.train_windows.u.shape[0], generator=generator)
        return WindowBatches(self.train_windows, self.batch_size, order)

    def val_dataloader(self) -> WindowBatches | list[PaddedWindows]:
        """Return all validation windows as one batch, or nothing."""
        return [] if self.valid_windows is None else WindowBatches(self.valid_windows, 0)
