"""The one way in: windows and options to a fitted error model with its record."""

import platform
from pathlib import Path

import torch
from torch import Tensor

import navlearn
from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import (
    FittedErrorModel,
    TrainingCurves,
    TrainingRecord,
    TrainingSource,
)
from navlearn.error_models.scaling import fit_scaling
from navlearn.errors import ShapeError
from navlearn.learning.checkpointing import fingerprint
from navlearn.learning.lm_training import train_by_lm
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows, check_windows


def fit_anarx(
    train: Windows,
    valid: Windows | None,
    options: AnarxOptions,
    training: TrainingOptions | None = None,
    *,
    source: TrainingSource | None = None,
    progress: bool = True,
    checkpoint_dir: Path | None = None,
    resume: bool = False,
) -> FittedErrorModel:
    """Train an ANARX network on windows.

    The same windows, options and seed give the same weights, with or without an interruption.

    Args:
        train: Training windows.
        valid: Validation windows, later in time than training; None trains to the end without
            early stopping.
        options: Shape of the network.
        training: How it is trained; None for the defaults.
        source: What is known about the data, for the record.
        progress: Shows a progress bar.
        checkpoint_dir: Folder for checkpoints; None writes none.
        resume: Goes on from the last checkpoint in that folder, if there is one.

    Returns:
        The model with its scaling, its variance by horizon, its record and its curves.

    Raises:
        ShapeError: Windows and options do not belong together.
        FitError: The data cannot be learned from.
        ConfigError: A checkpoint belongs to another training.
        OutputExistsError: A checkpoint is there and ``resume`` is False.
    """
    training = training or TrainingOptions()
    train = _matching(check_windows(train, "training windows"), options, "training windows")
    if valid is not None:
        valid = check_windows(valid, "validation windows")
        valid = _matching(valid, options, "validation windows")
    model = Anarx(options)
    used = _rows_in_use(train)
    model.set_scaling(fit_scaling(train.u, used), fit_scaling(train.y, used))
    digest = fingerprint(train, valid, options, training)
    if training.trainer == "lm":
        trainer = train_by_lm
    else:
        # Lightning takes seconds to import; only this trainer needs it.
        from navlearn.learning.adam_training import train_by_adam

        trainer = train_by_adam
    outcome = trainer(
        model,
        train,
        valid,
        training,
        progress=progress,
        checkpoint_dir=checkpoint_dir,
        resume=resume,
        digest=digest,
    )
    model.set_variance(variance_by_horizon(model, valid if valid is not None else train))
    model.eval()
    record = TrainingRecord(
        source=source or TrainingSource(),
        time_span=_time_span(train, source.time_step if source else 1.0),
        samples=_samples(train),
        validation_samples=_samples(valid) if valid is not None else 0,
        trainer=training.trainer,
        loop=training.loop,
        iterations=outcome.iterations,
        stopped=outcome.stopped,
        seed=training.seed,
        train_loss=outcome.train[outcome.best],
        valid_loss=outcome.valid[outcome.best] if outcome.valid else float("nan"),
        versions=(
            ("navlearn", navlearn.__version__),
            ("torch", str(torch.__version__)),
            ("python", platform.python_version()),
        ),
    )
    curves = TrainingCurves(train=outcome.train, valid=outcome.valid)
    return FittedErrorModel(
        kind="anarx", model=model, options=options, record=record, curves=curves
    )


@torch.no_grad()
def variance_by_horizon(model: Anarx, windows: Windows) -> Tensor:
    """Return the mean squared residual of the free run by row, physical units², shape (H, p).

    Args:
        model: Trained network.
        windows: Checked windows; warm-up rows are measured outputs and give no residual.
    """
    skip = windows.warmup
    state = model.initial_state(windows.u[:, 0], windows.y_start)
    if skip:
        y_start = windows.y_start if windows.y_start is not None else windows.y[:, 0] * 0.0
        state = model.warm_state(windows.u[:, :skip], windows.y[:, :skip], y_start)
    predicted, _ = model.run(windows.u[:, skip:], state)
    weight = windows.weight[:, skip:].unsqueeze(-1)
    square = (weight * (predicted - windows.y[:, skip:]) ** 2).sum(0)
    counts = weight.sum(0).squeeze(-1)
    horizon = int((counts > 0).nonzero().max()) + 1
    counts = counts[:horizon].clamp(min=1e-300).unsqueeze(-1)
    return square[:horizon] / counts


def _matching(windows: Windows, options: AnarxOptions, name: str) -> Windows:
    found = (windows.u.shape[-1], windows.y.shape[-1])
    if found != (options.inputs, options.outputs):
        raise ShapeError(
            f"{name}: {found[0]} inputs and {found[1]} outputs, but the options say "
            f"{options.inputs} and {options.outputs}"
        )
    return windows


def _rows_in_use(windows: Windows) -> Tensor:
    """Return the weights, with warm-up rows counting as an average row does."""
    used = windows.weight.clone()
    scored = used[:, windows.warmup :]
    used[:, : windows.warmup] = scored[scored > 0].mean()
    return used


def _samples(windows: Windows) -> int:
    return int((windows.weight[:, windows.warmup :] > 0).sum())


def _time_span(windows: Windows, time_step: float) -> tuple[float, float]:
    first, last = windows.start_time.min(), windows.start_time.max()
    return float(first), float(last) + windows.u.shape[1] * time_step
