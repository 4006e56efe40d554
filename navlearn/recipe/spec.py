"""Model specs: what is learned, as the YAML of ``models/`` tells it."""

import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.strict import Section, parse
from navlearn.recipe.yaml_file import read_yaml

if TYPE_CHECKING:
    from navlearn.error_models.anarx import AnarxOptions
    from navlearn.learning.options import TrainingOptions

Seed = Annotated[int, Field(ge=0, lt=2**63)]
Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


def _plain_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise ValueError(
            f"{name!r} cannot be part of a file's name; use letters, digits, '_', '-' and '.'"
        )
    return name


def _known_channels(names: tuple[str, ...]) -> tuple[str, ...]:
    from navlearn.error_models.regressors import CHANNELS

    for name in names:
        if name not in CHANNELS:
            raise ValueError(
                f"unknown input {name!r}{nearest_hint(name, CHANNELS)}; known: "
                f"{', '.join(CHANNELS)}"
            )
        if names.count(name) > 1:
            raise ValueError(f"the input {name!r} is listed twice; list each once")
    return names


Channels = Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(_known_channels)]
PlainName = Annotated[str, AfterValidator(_plain_name)]


class SafeguardSpec(Section):
    """When a correction is trusted, and how far.

    Attributes:
        bounds: Whether inputs are clamped to their training range and outputs limited.
        output_limit: Limit of an output about its training mean, in training standard
            deviations.
        gate: Whether the model must first prove itself on recent emulated outages.
        gate_margin: Least improvement asked for there, as a share of the error without.
        gate_fewest: Fewest emulated outages that can prove it.
    """

    bounds: bool = True
    output_limit: Positive = 5.0
    gate: bool = True
    gate_margin: Annotated[float, Field(ge=0, lt=1)] = 0.05
    gate_fewest: Count = 5


class ModelSpec(Section):
    """One error model: its inputs, its shape and how it is trained.

    Attributes:
        name: Short name, used as the method's name and for files.
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
        safeguard: When a correction is trusted.
        question: What the model is meant to answer.
        notes: Anything a reader should know.
    """

    name: PlainName
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
    safeguard: SafeguardSpec = SafeguardSpec()
    question: str = ""
    notes: str = ""

    @model_validator(mode="after")
    def _options_go_together(self) -> "ModelSpec":
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


def load_spec(path: str | Path) -> ModelSpec:
    """Read a model spec.

    Args:
        path: A YAML file such as ``models/anarx.yaml``.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="model spec")
    spec = parse(ModelSpec, file.content, file=file)
    if spec.trained is None:
        return spec
    return spec.model_copy(update={"trained": (file.path.parent / spec.trained).resolve()})
