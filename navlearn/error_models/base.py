"""The contract that every error model keeps, and the record of what it was trained on.

An error model maps regressors to a correction. It is learned while fixes are there and runs on
its own through an outage: ``step`` in a stream, ``forward`` over windows, both the same.
"""

from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

from torch import Tensor, nn

from navlearn.errors import ConfigError

ACTS_ON = ("gyro_rate", "azimuth_rate", "azimuth", "position", "speed_scale", "pseudorange")
OUTPUT_UNITS: Final[dict[str, str]] = {
    "gyro_rate": "rad/s",
    "azimuth_rate": "rad per step",
    "azimuth": "rad",
    "position": "m per step",
    "speed_scale": "1",
    "pseudorange": "m",
}
"""Unit of a correction by what it acts on."""

REGIMES = ("online", "other-drives", "adapted")


@runtime_checkable
class ErrorModel(Protocol):
    """What every error model offers; an ``nn.Module`` that scripts.

    Attributes:
        memory: Samples of the past that a correction depends on.
    """

    memory: int

    def initial_state(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return the state before the first step, from its inputs (..., m)."""
        ...

    def step(self, u: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the correction (..., p) for inputs (..., m), and the next state."""
        ...

    def forward(self, u: Tensor, y_start: Tensor | None = None) -> Tensor:
        """Return corrections (..., T, p) over windows (..., T, m); equals ``step`` over them."""
        ...

    def prediction_variance(self, steps: int) -> Tensor:
        """Return the variance of a correction that many steps after the start, shape (p,)."""
        ...


@dataclass(frozen=True, kw_only=True)
class TrainingSource:
    """What a caller knows about training data and the tensors do not say.

    Attributes:
        logs: Names of the logs.
        regime: ``online`` (this drive, before the outage), ``other-drives`` or ``adapted``.
        acts_on: What the correction is subtracted from, one of ``ACTS_ON``.
        inputs: Names of the regressors, in order.
        outputs: Names of the outputs, in order.
        time_step: Seconds between rows.
        input_units: Units of the regressors, in order; empty where all are channels of
            ``regressors``, whose units are known.
    """

    logs: tuple[str, ...] = ()
    regime: str = "online"
    acts_on: str = "position"
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    time_step: float = 1.0
    input_units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.regime not in REGIMES:
            raise ConfigError(f"regime {self.regime!r} is not one of {', '.join(REGIMES)}")
        if self.acts_on not in ACTS_ON:
            raise ConfigError(f"acts_on {self.acts_on!r} is not one of {', '.join(ACTS_ON)}")
        if not self.time_step > 0.0:
            raise ConfigError(f"time_step is {self.time_step} s; it must be positive")
        if len(self.input_units) not in (0, len(self.inputs)):
            raise ConfigError(
                f"{len(self.input_units)} input_units for {len(self.inputs)} inputs; give one "
                "each, or none"
            )


@dataclass(frozen=True, kw_only=True)
class TrainingRecord:
    """What an error model was trained on, and how it went.

    Attributes:
        source: Logs, regime and channels.
        time_span: First and last time of the training windows, s from the start of the log.
        samples: Rows that counted in training.
        validation_samples: Rows that counted in validation.
        trainer: Name of the algorithm.
        loop: ``closed`` or ``open``.
        iterations: Iterations or epochs that ran.
        stopped: Why training ended.
        seed: Seed of everything drawn.
        train_loss: Mean squared residual of the model that was kept, standardised units.
        valid_loss: The same on the validation windows; NaN without any.
        versions: Pairs of package and version.
    """

    source: TrainingSource
    time_span: tuple[float, float]
    samples: int
    validation_samples: int
    trainer: str
    loop: str
    iterations: int
    stopped: str
    seed: int
    train_loss: float
    valid_loss: float
    versions: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class TrainingCurves:
    """Losses by iteration, standardised units.

    Attributes:
        train: Mean squared residual on the training windows, the starting point first.
        valid: The same on the validation windows; empty without any.
    """

    train: tuple[float, ...]
    valid: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class FittedErrorModel:
    """A trained error model with its record.

    Attributes:
        kind: Name of the family, such as ``anarx``.
        model: The module, ready to run.
        options: The options that it was built with.
        record: What it was trained on.
        curves: How training went.
    """

    kind: str
    model: nn.Module
    options: Any
    record: TrainingRecord
    curves: TrainingCurves
