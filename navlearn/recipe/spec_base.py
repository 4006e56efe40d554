"""What the specs of all error models share."""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.strict import Section

Seed = Annotated[int, Field(ge=0, lt=2**63)]
Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


def _plain_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", name):
        raise ValueError(
            f"{name!r} cannot be part of a file's name; use letters, digits, '_', '-', '+' and '.'"
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


class SpecBase(Section):
    """One error model, whatever its kind; a subclass per kind adds its shape.

    Attributes:
        name: Short name, used as the method's name and for files.
        safeguard: When a correction is trusted.
        question: What the model is meant to answer.
        notes: Anything a reader should know.
    """

    name: PlainName
    safeguard: SafeguardSpec = SafeguardSpec()
    question: str = ""
    notes: str = ""

    @model_validator(mode="before")
    @classmethod
    def _rest_of_the_safeguard(cls, content: Any) -> Any:
        """Let a safeguard that is stated in part keep what its kind of model has for the rest."""
        if not isinstance(content, dict) or not isinstance(content.get("safeguard"), dict):
            return content
        own = cls.model_fields["safeguard"].default.model_dump()
        return {**content, "safeguard": {**own, **content["safeguard"]}}

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        raise NotImplementedError

    @property
    def regime(self) -> str:
        """How it is trained: ``online``, ``other-drives`` or ``adapted``."""
        return "online"

    @property
    def seeds(self) -> dict[str, int]:
        """Seeds of everything that it draws, by name."""
        return {}

    def files(self) -> tuple[Path, ...]:
        """Return files whose content decides what the model does."""
        return ()
