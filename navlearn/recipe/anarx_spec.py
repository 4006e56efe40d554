"""Spec of an additive NARX network, as the YAML of ``models/`` tells it."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import model_validator

from navlearn.recipe.spec_base import Channels, Count, NotNegative, Positive, Seed, SpecBase

if TYPE_CHECKING:
    from navlearn.error_models.anarx import AnarxOptions
    from navlearn.learning.options import TrainingOptions


class AnarxSpec(SpecBase):
    """An additive NARX network: its inputs, its shape and how it is trained.

    Attributes:
        type: Kind of model.
        acts_on: What its output corrects: ``position`` along and across the track, or
            ``azimuth_rate``.
        inputs: Regressors beside the model's own past outputs, any of
            :data:`navlearn.error_models.regressors.CHANNELS`.
        lags: Number of lags, each with a sub-network of its own.
        hidden: Hidden units of each lag's sub-network.
        activation: Hidden activation.
        linear_path: Whether each lag also has a direct linear term.
        trainer: ``lm`` is Levenberg-Marquardt, ``adam`` is Lightning with Adam.
        loop: ``closed`` trains on the model's own past outputs, ``open`` on measured ones.
        objective: ``step`` scores every output, ``accumulated`` their running sum.
        max_iterations: Upper bound of training iterations (of epochs for ``adam``).
        patience: Iterations without a better validation loss before training stops.
        starts: Random starts of which the best goes on.
        ridge: Penalty on the mean square of the weights.
        learning_rate: Step size of ``adam``.
        seed: Seed of the initial weights.
        trained: Model that ``navlearn train`` fitted on other drives, relative to the spec: used
            frozen, and nothing is learned on the drive at hand.
    """

    type: Literal["anarx"] = "anarx"
    acts_on: Literal["position", "azimuth_rate"] = "azimuth_rate"
    inputs: Channels = (
        "yaw_rate",
        "abs_yaw_rate",
        "delay",
    )
    lags: Count = 1
    hidden: Count = 3
    activation: Literal["sigmoid", "tanh"] = "sigmoid"
    linear_path: bool = True
    trainer: Literal["lm", "adam"] = "lm"
    loop: Literal["closed", "open"] = "closed"
    objective: Literal["step", "accumulated"] = "accumulated"
    max_iterations: Count = 60
    patience: Count = 10
    starts: Count = 2
    ridge: NotNegative = 1.0
    learning_rate: Positive = 1e-2
    seed: Seed = 0
    trained: Path | None = None

    @model_validator(mode="after")
    def _options_go_together(self) -> "AnarxSpec":
        self.anarx_options(outputs=1)
        self.training_options()
        return self

    def anarx_options(self, *, outputs: int) -> "AnarxOptions":
        """Return the options of the network.

        Args:
            outputs: Number of outputs.
        """
        from navlearn.error_models.anarx import AnarxOptions

        return AnarxOptions(
            inputs=len(self.inputs),
            outputs=outputs,
            lags=self.lags,
            hidden=self.hidden,
            activation=self.activation,
            linear_path=self.linear_path,
            safeguard=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
        )

    def training_options(self) -> "TrainingOptions":
        """Return the options of its training."""
        from navlearn.learning.options import TrainingOptions

        names = (field.name for field in dataclasses.fields(TrainingOptions))
        shared = {name: getattr(self, name) for name in names if name in type(self).model_fields}
        return TrainingOptions(**shared)

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        return (
            "the honest filter, through the outage less what ANARX predicts "
            f"({self.acts_on}, inputs {', '.join(self.inputs)})"
        )

    @property
    def regime(self) -> str:
        """How it is trained: ``online``, or ``other-drives`` where ``trained`` names a file."""
        return "online" if self.trained is None else "other-drives"

    @property
    def seeds(self) -> dict[str, int]:
        """Seed of the initial weights."""
        return {self.name: self.seed}

    def files(self) -> tuple[Path, ...]:
        """Return the file that ``trained`` names, if any."""
        return () if self.trained is None else (self.trained,)
