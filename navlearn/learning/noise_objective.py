"""What a search for noise makes small: minus the log-likelihood of drives, and a prior.

The prior is normal in the logarithms, about the start: an entry of which the drives tell nothing
stays there, and none runs off to nothing or infinity.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navlearn.errors import FilterDivergedError
from navlearn.learning.drive_likelihood import DriveLikelihood, Held, by_window
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import FreeParameters
from navlearn.learning.quasi_newton import Point


class NoiseObjective:
    """Drives behind one filter, as a function of the logarithms of its free noise entries.

    Attributes:
        drives: The drives.
        parameters: What is free.
        options: How innovations are judged, and the prior.
        held: Per drive the verdicts in use, and where blocks start.
        evaluations: How often the function was asked for.
    """

    def __init__(
        self,
        drives: Sequence[DriveLikelihood],
        parameters: FreeParameters,
        options: TuningOptions,
    ) -> None:
        """Take drives with their filter."""
        self.drives = tuple(drives)
        self.parameters = parameters
        self.options = options
        self.held: tuple[Held, ...] = ()
        self.evaluations = 0

    @property
    def precision(self) -> float:
        """Inverse variance of the prior of a logarithm."""
        return 1.0 / math.log(self.options.prior_factor) ** 2

    def believe_all(self) -> None:
        """Take verdicts that believe everything."""
        self.held = tuple(drive.all_believed() for drive in self.drives)

    def judge(self, logs: Tensor) -> None:
        """Take the verdicts of the filter's own gate.

        Args:
            logs: Logarithms, shape (P,).

        Raises:
            FilterDivergedError: A run is not finite.
        """
        with torch.no_grad():
            noise = self.parameters.noise(logs)
            self.held = tuple(
                drive.judged(noise, self.parameters.started(drive.start, logs))
                for drive in self.drives
            )

    def __call__(self, logs: Tensor) -> Point:
        """Return the function and its gradient; infinite where a filter is lost.

        Args:
            logs: Logarithms, shape (P,).
        """
        self.evaluations += 1
        pull = logs - self.parameters.start
        value = 0.5 * self.precision * float(pull @ pull)
        gradient = self.precision * pull
        try:
            for drive, held in zip(self.drives, self.held, strict=True):
                total, slope = self._of_drive(drive, held, logs)
                value, gradient = value - total, gradient - slope
        except FilterDivergedError:
            return Point(logs, math.inf, torch.zeros_like(logs))
        return Point(logs, value, gradient)

    def _of_drive(self, drive: DriveLikelihood, held: Held, logs: Tensor) -> tuple[float, Tensor]:
        leaf = logs.detach().clone().requires_grad_(True)
        with torch.enable_grad():
            found = drive.foretold(
                held,
                self.parameters.noise(leaf),
                self.parameters.started(drive.start, leaf),
                self.options.likelihood,
            )
            total = found.log_likelihood.sum()
            (slope,) = torch.autograd.grad(total, leaf)
        if not bool(torch.isfinite(slope).all()):
            raise FilterDivergedError(f"{drive.name}: the gradient is not finite")
        return float(total.detach()), slope

    def windows(self, logs: Tensor) -> Tensor:
        """Return log-likelihoods of windows of all drives, nats, shape (W,).

        Args:
            logs: Logarithms, shape (P,).

        Raises:
            FilterDivergedError: A filter is lost.
        """
        parts = []
        with torch.no_grad():
            for drive, held in zip(self.drives, self.held, strict=True):
                found = drive.foretold(
                    held,
                    self.parameters.noise(logs),
                    self.parameters.started(drive.start, logs),
                    self.options.likelihood,
                )
                sums, _ = by_window(
                    drive.time, found.log_likelihood, self.options.window, drive.aligned
                )
                parts.append(sums.sum(-1))
        return torch.cat(parts)
