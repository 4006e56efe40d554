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
        try:
            return self.with_windows(logs)[0]
        except FilterDivergedError:
            return Point(logs, math.inf, torch.zeros_like(logs))

    def with_windows(self, logs: Tensor) -> tuple[Point, Tensor]:
        """Return the function, and the log-likelihoods of windows of time.

        Args:
            logs: Logarithms, shape (P,).

        Returns:
            The function and its gradient; log-likelihoods of the windows of all drives, nats,
            shape (W,).

        Raises:
            FilterDivergedError: A filter is lost.
        """
        pull = logs - self.parameters.start
        value = 0.5 * self.precision * float(pull @ pull)
        gradient = self.precision * pull
        windows = []
        for k, drive in enumerate(self.drives):
            leaf = logs.detach().clone().requires_grad_(True)
            with torch.enable_grad():
                by_kind = self._foretold(k, leaf)
                total = by_kind.sum()
                (slope,) = torch.autograd.grad(total, leaf)
            if not bool(torch.isfinite(slope).all()):
                raise FilterDivergedError(f"{drive.name}: the gradient is not finite")
            value, gradient = value - float(total.detach()), gradient - slope
            windows.append(self._in_windows(drive, by_kind.detach()))
        return Point(logs, value, gradient), torch.cat(windows)

    def likelihood(self, logs: Tensor) -> float:
        """Return the log-likelihood alone, nats.

        Args:
            logs: Logarithms, shape (P,).

        Raises:
            FilterDivergedError: A filter is lost.
        """
        with torch.no_grad():
            return sum(float(self._foretold(k, logs).sum()) for k in range(len(self.drives)))

    def _foretold(self, k: int, logs: Tensor) -> Tensor:
        """Return the log-likelihood of one drive, and begin from there the next time."""
        drive, held = self.drives[k], self.held[k]
        found = drive.foretold(
            held,
            self.parameters.noise(logs),
            self.parameters.started(drive.start, logs),
            self.options.likelihood,
        )
        self.held = (*self.held[:k], held._replace(begin=found.begin), *self.held[k + 1 :])
        return found.log_likelihood

    def _in_windows(self, drive: DriveLikelihood, by_kind: Tensor) -> Tensor:
        sums, _ = by_window(drive.time, by_kind, self.options.window, drive.aligned)
        return sums.sum(-1)
