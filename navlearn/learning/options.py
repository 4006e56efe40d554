"""Options of training."""

from dataclasses import dataclass

from navlearn.errors import ConfigError

TRAINERS = ("lm", "adam")
LOOPS = ("closed", "open")
OBJECTIVES = ("step", "accumulated")


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """How an error model is trained.

    Attributes:
        trainer: ``lm`` (Levenberg–Marquardt) or ``adam`` (Lightning).
        loop: ``closed`` trains the free run, ``open`` the prediction one step ahead.
        objective: ``step`` scores outputs, ``accumulated`` their running sum over a window: the
            position error where outputs are its increments.
        max_iterations: Iterations of LM or epochs of Adam, at the most.
        patience: Iterations without a better validation loss before training stops.
        seed: Seed of initial weights and batches.
        starts: Random starts of which the best goes on.
        start_iterations: Iterations of LM, one step ahead, that each start is given.
        ridge: The loss is the mean square residual plus this times the sum of squared weights, in
            standardised units.
        learning_rate: Step size of Adam.
        batch_size: Windows per step of Adam; 0 takes all at once.
        first_horizon: Rows of a window that Adam scores at first; 0 scores all at once.
        horizon_epochs: Epochs over which that grows to the whole window.
        checkpoint_every: Iterations between checkpoints, where a folder for them is given.
    """

    trainer: str = "lm"
    loop: str = "closed"
    objective: str = "step"
    max_iterations: int = 60
    patience: int = 10
    seed: int = 0
    starts: int = 2
    start_iterations: int = 5
    ridge: float = 1e-4
    learning_rate: float = 1e-2
    batch_size: int = 0
    first_horizon: int = 0
    horizon_epochs: int = 0
    checkpoint_every: int = 10

    def __post_init__(self) -> None:
        choices = (("trainer", TRAINERS), ("loop", LOOPS), ("objective", OBJECTIVES))
        for name, known in choices:
            if getattr(self, name) not in known:
                raise ConfigError(
                    f"training: {name} {getattr(self, name)!r}; choose one of {', '.join(known)}"
                )
        for name, least in (
            ("max_iterations", 1),
            ("patience", 1),
            ("starts", 1),
            ("start_iterations", 0),
            ("ridge", 0),
            ("batch_size", 0),
            ("first_horizon", 0),
            ("horizon_epochs", 0),
            ("checkpoint_every", 1),
        ):
            if getattr(self, name) < least:
                raise ConfigError(
                    f"training: {name} is {getattr(self, name)}; it must be at least {least}"
                )
        if not self.learning_rate > 0.0:
            raise ConfigError(f"training: learning_rate is {self.learning_rate}; it must be > 0")
        if self.objective == "accumulated" and self.loop == "open":
            raise ConfigError("training: the accumulated objective needs loop: closed")
