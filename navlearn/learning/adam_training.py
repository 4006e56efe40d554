"""Training an ANARX network by Adam through Lightning: early stopping, checkpoints, resume."""

import logging
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import EarlyStopping
from tqdm import tqdm
from typing_extensions import override

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.anarx_jacobian import unpack_weights
from navlearn.learning.anarx_least_squares import AnarxLeastSquares, pad_windows
from navlearn.learning.checkpointing import claim_checkpoint, read_checkpoint
from navlearn.learning.datamodule import WindowDataModule
from navlearn.learning.lm_training import TrainingOutcome, best_start
from navlearn.learning.options import TrainingOptions
from navlearn.learning.task import AnarxTask
from navlearn.learning.windows import Windows


class EpochLog(Callback):
    """Keeps the losses, the best weights and the progress bar.

    Args:
        digest: Fingerprint of data and options, written into every checkpoint.
        training: Options.
        progress: Shows a progress bar.
        path: Checkpoint, or None.
    """

    def __init__(
        self, digest: str, training: TrainingOptions, progress: bool, path: Path | None
    ) -> None:
        self.digest, self.progress, self.path = digest, progress, path
        self.epochs, self.every = training.max_iterations, training.checkpoint_every
        self.train: list[float] = []
        self.valid: list[float] = []
        self.best = 0
        self.best_weights: dict[str, Any] = {}
        self.bar: tqdm[Any] | None = None

    @override
    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Open the bar where training stands."""
        self.bar = tqdm(
            total=self.epochs,
            initial=trainer.current_epoch,
            desc="Adam",
            disable=not self.progress,
            leave=False,
        )

    @override
    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Note the losses of the epoch, whose validation ran before, and write a checkpoint."""
        losses = trainer.callback_metrics
        self.train.append(float(losses["train"]))
        if "valid" in losses:
            self.valid.append(float(losses["valid"]))
        watched = self.valid or self.train
        if not self.best_weights or watched[-1] < watched[self.best]:
            self.best = len(watched) - 1
            self.best_weights = {
                name: value.detach().clone() for name, value in pl_module.state_dict().items()
            }
        if self.bar is not None:
            shown = ", ".join(f"{k} {float(v):.4g}" for k, v in sorted(losses.items()))
            self.bar.set_postfix_str(shown, refresh=False)
            self.bar.update(1)
        done = trainer.current_epoch + 1
        ended = trainer.should_stop or done == self.epochs
        if self.path is not None and (ended or done % self.every == 0):
            # Whole or not at all: a torn checkpoint is worse than an old one.
            partial = self.path.with_suffix(".partial")
            trainer.save_checkpoint(partial)
            partial.replace(self.path)

    @override
    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Close the bar, also after an interruption."""
        if self.bar is not None:
            self.bar.close()

    @override
    def on_save_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Write the fingerprint where a reader looks for it."""
        checkpoint["fingerprint"] = self.digest

    @override
    def state_dict(self) -> dict[str, Any]:
        """Return what an interrupted training needs."""
        return {
            "train": self.train,
            "valid": self.valid,
            "best": self.best,
            "best_weights": self.best_weights,
        }

    @override
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take it up again."""
        self.train, self.valid = list(state_dict["train"]), list(state_dict["valid"])
        self.best, self.best_weights = state_dict["best"], state_dict["best_weights"]


def train_by_adam(
    model: Anarx,
    train: Windows,
    valid: Windows | None,
    training: TrainingOptions,
    *,
    progress: bool,
    checkpoint_dir: Path | None,
    resume: bool,
    digest: str,
) -> TrainingOutcome:
    """Train a network whose scaling is set, and leave the best weights in it.

    Args:
        model: Network; its weights are overwritten.
        train: Checked training windows.
        valid: Checked validation windows, or None.
        training: Options.
        progress: Shows a progress bar.
        checkpoint_dir: Folder of the checkpoints, or None.
        resume: Goes on from the last checkpoint where there is one.
        digest: Fingerprint of data and options.
    """
    path = (
        claim_checkpoint(checkpoint_dir, "adam.ckpt", resume)
        if checkpoint_dir is not None
        else None
    )
    resume_from: Path | None = None
    if path is not None and path.exists():
        read_checkpoint(path, digest)
        resume_from = path
    else:
        _start(model, train, training)
    task = AnarxTask(model, training, train.u.shape[1] - train.warmup)
    data = WindowDataModule(
        pad_windows(model, train),
        pad_windows(model, valid) if valid is not None else None,
        batch_size=training.batch_size,
        seed=training.seed,
    )
    log = EpochLog(digest, training, progress, path)
    callbacks: list[Callback] = [log]
    if valid is not None:
        callbacks.append(EarlyStopping("valid", patience=training.patience, mode="min"))
    with _quiet(), tempfile.TemporaryDirectory() as scratch:
        trainer = Trainer(
            accelerator="cpu",
            devices=1,
            logger=False,
            max_epochs=training.max_iterations,
            callbacks=callbacks,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            num_sanity_val_steps=0,
            reload_dataloaders_every_n_epochs=1,
            default_root_dir=scratch,
        )
        trainer.fit(task, datamodule=data, ckpt_path=resume_from)
    if log.best_weights:
        task.load_state_dict(log.best_weights)
    stopped = "patience" if trainer.current_epoch < training.max_iterations else "iterations"
    return TrainingOutcome(
        trainer.current_epoch, stopped, tuple(log.train), tuple(log.valid), log.best
    )


def _start(model: Anarx, train: Windows, training: TrainingOptions) -> None:
    """Set the weights to those of the best random start."""
    problem = AnarxLeastSquares(
        model,
        train,
        closed=training.loop == "closed",
        accumulate=training.objective == "accumulated",
    )
    theta = best_start(model, train, problem, training).theta
    model.set_weights(unpack_weights(theta, problem.like, problem.linear_path))


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Lightning's advice and greetings off the screen; its errors still come through."""
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module="lightning")
            yield
    finally:
        logger.setLevel(level)
