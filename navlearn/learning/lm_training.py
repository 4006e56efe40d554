"""Training an ANARX network by Levenberg–Marquardt: starts, early stopping, resume."""

from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from navlearn.error_models.anarx import Anarx
from navlearn.error_models.anarx_jacobian import unpack_weights
from navlearn.errors import FitError
from navlearn.learning.anarx_least_squares import AnarxLeastSquares
from navlearn.learning.checkpointing import claim_checkpoint, read_checkpoint, write_checkpoint
from navlearn.learning.initialise import random_start
from navlearn.learning.levenberg_marquardt import (
    LmOptions,
    LmState,
    levenberg_marquardt,
    start_state,
)
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows

COMPARED_ITERATIONS = 3


class TrainingOutcome(NamedTuple):
    """What a trainer hands back; the best weights are in the model already.

    Attributes:
        iterations: Iterations or epochs that ran.
        stopped: Why training ended.
        train: Mean squared residual by iteration.
        valid: The same on validation windows.
        best: Iteration that was kept.
    """

    iterations: int
    stopped: str
    train: tuple[float, ...]
    valid: tuple[float, ...]
    best: int


class _Progress:
    """Losses so far and the best weights, with what a checkpoint needs."""

    def __init__(
        self,
        problem: AnarxLeastSquares,
        check: AnarxLeastSquares | None,
        training: TrainingOptions,
        path: Path | None,
        digest: str,
    ) -> None:
        self.problem, self.check, self.training = problem, check, training
        self.path, self.digest = path, digest
        self.train: list[float] = []
        self.valid: list[float] = []
        self.best = 0
        self.best_theta: Tensor | None = None
        self.bar: tqdm[Any] | None = None

    def note(self, state: LmState) -> bool:
        """Note losses after an iteration; True where patience has run out."""
        self.train.append(self.problem.mean_square(state.theta))
        if self.check is not None:
            self.valid.append(self.check.mean_square(state.theta))
        watched = self.valid if self.check is not None else self.train
        if self.best_theta is None or watched[-1] < watched[self.best]:
            self.best, self.best_theta = len(watched) - 1, state.theta
        if self.bar is not None:
            self.bar.set_postfix_str(
                f"train {self.train[-1]:.4g}"
                + (f", valid {self.valid[-1]:.4g}" if self.valid else ""),
                refresh=False,
            )
            self.bar.update(state.iteration - self.bar.n)
        patience_over = bool(self.valid) and len(watched) - 1 - self.best >= self.training.patience
        ended = bool(state.stopped) or patience_over
        if self.path is not None and (
            ended
            or state.iteration % self.training.checkpoint_every == 0
            or state.iteration == self.training.max_iterations
        ):
            self._write(self.path, state._replace(stopped="patience") if patience_over else state)
        return patience_over

    def _write(self, path: Path, state: LmState) -> None:
        content = {
            "fingerprint": self.digest,
            "state": state._asdict(),
            "train": self.train,
            "valid": self.valid,
            "best": self.best,
            "best_theta": self.best_theta,
        }
        write_checkpoint(path, content)

    def restore(self, content: dict[str, Any]) -> LmState:
        """Take up what a checkpoint holds."""
        self.train, self.valid = list(content["train"]), list(content["valid"])
        self.best, self.best_theta = content["best"], content["best_theta"]
        return LmState(**content["state"])


def train_by_lm(
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
        checkpoint_dir: Folder of the checkpoint, or None.
        resume: Goes on from the checkpoint where there is one.
        digest: Fingerprint of data and options.

    Raises:
        FitError: No start gives a finite loss.
    """
    closed, accumulate = training.loop == "closed", training.objective == "accumulated"
    problem = AnarxLeastSquares(model, train, closed=closed, accumulate=accumulate)
    check = (
        AnarxLeastSquares(model, valid, closed=closed, accumulate=accumulate)
        if valid is not None
        else None
    )
    path = claim_checkpoint(checkpoint_dir, "lm.pt", resume) if checkpoint_dir is not None else None
    watch = _Progress(problem, check, training, path, digest)
    options = lm_options(problem, training, training.max_iterations)
    if path is not None and path.exists():
        state = watch.restore(read_checkpoint(path, digest))
    else:
        state = best_start(model, train, problem, training)
        watch.note(state)
    with tqdm(
        total=training.max_iterations,
        initial=state.iteration,
        desc="Levenberg-Marquardt",
        disable=not progress,
        leave=False,
    ) as bar:
        watch.bar = bar
        state = levenberg_marquardt(problem, state, options, watch.note)
    theta = watch.best_theta if watch.best_theta is not None else state.theta
    model.set_weights(unpack_weights(theta, problem.like, problem.linear_path))
    stopped = "patience" if state.stopped == "callback" else state.stopped
    return TrainingOutcome(
        state.iteration, stopped, tuple(watch.train), tuple(watch.valid), watch.best
    )


def lm_options(problem: AnarxLeastSquares, training: TrainingOptions, iterations: int) -> LmOptions:
    """Return options whose ridge is relative to the total weight of the data."""
    total = float(problem.data.weight.sum()) * problem.data.y.shape[-1]
    return LmOptions(max_iterations=iterations, ridge=training.ridge * total)


def best_start(
    model: Anarx, train: Windows, problem: AnarxLeastSquares, training: TrainingOptions
) -> LmState:
    """Return the best of several random starts, counted from iteration zero.

    Every draw is first improved one step ahead, which is cheap. In closed loop the best of these
    and the best start without feedback get a few iterations each, and the better goes on.

    Args:
        model: Network with its scaling set.
        train: Training windows.
        problem: Problem to be solved.
        training: Options.

    Raises:
        FitError: No start gives a finite loss.
    """
    generator = torch.Generator().manual_seed(training.seed)
    ahead = AnarxLeastSquares(model, train, closed=False) if problem.closed else problem
    polish = lm_options(ahead, training, training.start_iterations)
    with_feedback: list[LmState] = []
    without: list[LmState] = []
    for _ in range(training.starts):
        theta = random_start(ahead, generator, feedback=True, ridge=polish.ridge)
        theta = levenberg_marquardt(ahead, theta, polish).theta
        with_feedback.append(start_state(theta)._replace(cost=problem.cost(theta)))
        if problem.closed:
            theta = random_start(problem, generator, feedback=False, ridge=polish.ridge)
            without.append(start_state(theta)._replace(cost=problem.cost(theta)))
    finalists = [
        min(states, key=lambda state: state.cost)
        for kind in (with_feedback, without)
        if (states := [state for state in kind if state.cost < float("inf")])
    ]
    if not finalists:
        raise FitError(
            f"none of {training.starts} starts gives a finite loss; look at the scale of the "
            "targets, or raise starts"
        )
    if len(finalists) > 1:
        trial = lm_options(problem, training, COMPARED_ITERATIONS)
        finalists = [levenberg_marquardt(problem, state, trial) for state in finalists]
    best = min(finalists, key=lambda state: state.cost)
    return start_state(best.theta)._replace(damping=best.damping)
