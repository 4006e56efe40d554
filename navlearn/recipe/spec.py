"""Model specs: what is learned, as the YAML of ``models/`` tells it."""

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from navlearn.recipe.strict import Section, parse
from navlearn.recipe.yaml_file import read_yaml

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
        acts_on: What its output corrects.
        inputs: Regressors beside the model's own past outputs.
        lags: Number of lags, each with a sub-network of its own.
        hidden: Hidden units of each lag's sub-network.
        activation: Hidden activation.
        linear_path: Whether each lag also has a direct linear term.
        trainer: ``lm`` is Levenberg-Marquardt, ``adam`` is Lightning with Adam.
        loop: ``closed`` trains on the model's own past outputs, ``open`` on measured ones.
        max_iterations: Upper bound of training iterations (of epochs for ``adam``).
        seed: Seed of the initial weights.
        safeguard: When a correction is trusted.
        question: What the model is meant to answer.
        notes: Anything a reader should know.
    """

    name: PlainName
    type: Literal["anarx"] = "anarx"
    acts_on: Literal["position"] = "position"
    inputs: Annotated[tuple[str, ...], Field(min_length=1)] = ("yaw_rate", "speed", "delay")
    lags: Count = 2
    hidden: Count = 5
    activation: Literal["sigmoid", "tanh"] = "sigmoid"
    linear_path: bool = True
    trainer: Literal["lm", "adam"] = "lm"
    loop: Literal["closed", "open"] = "closed"
    max_iterations: Count = 100
    seed: Seed = 0
    safeguard: SafeguardSpec = SafeguardSpec()
    question: str = ""
    notes: str = ""


def load_spec(path: str | Path) -> ModelSpec:
    """Read a model spec.

    Args:
        path: A YAML file such as ``models/anarx.yaml``.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="model spec")
    return parse(ModelSpec, file.content, file=file)
