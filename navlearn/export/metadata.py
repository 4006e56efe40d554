"""What a predictor says about itself: a JSON text inside the file."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from navlearn.error_models.base import OUTPUT_UNITS, FittedErrorModel
from navlearn.errors import ConfigError
from navlearn.fusion.error_state import ERROR_UNITS

FORMAT: Final = "navlearn predictor 1"

INPUT_UNITS: Final[dict[str, str]] = {
    "yaw_rate": "rad/s",
    "abs_yaw_rate": "rad/s",
    "speed": "m/s",
    "acceleration": "m/s²",
    "lateral_acceleration": "m/s²",
    "f_x": "m/s²",
    "f_y": "m/s²",
    "pitch": "rad",
    "roll": "rad",
    "stationary": "1",
    "turned_angle": "rad",
    "sin_turned_angle": "1",
    "cos_turned_angle": "1",
    "distance": "m",
    "delay": "60 s",
}
"""Units of the channels of :mod:`navlearn.error_models.regressors`."""


@dataclass(frozen=True, kw_only=True)
class PredictorMetadata:
    """What a user of a predictor must know.

    Attributes:
        format: Name and version of the metadata's form.
        kind: Family of the model, such as ``anarx``.
        acts_on: What the correction is subtracted from.
        inputs: Names of the inputs, in order.
        input_units: Their units.
        outputs: Names of the outputs, in order.
        output_units: Their units.
        time_step_s: Seconds between rows.
        memory: Samples of the past that an output depends on.
        trained_on: Logs, regime, time span, samples, trainer, seed and losses of the training.
        versions: Versions of the packages that trained the model, by name.
    """

    format: str
    kind: str
    acts_on: str
    inputs: tuple[str, ...]
    input_units: tuple[str, ...]
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    time_step_s: float
    memory: int
    trained_on: Mapping[str, Any]
    versions: Mapping[str, str]

    def to_json(self) -> str:
        """Return the metadata as JSON text."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> "PredictorMetadata":
        """Return metadata from JSON text.

        Args:
            text: What :meth:`to_json` wrote.

        Raises:
            ConfigError: The text is no metadata of a navlearn predictor.
        """
        try:
            content = json.loads(text)
            if content["format"] != FORMAT:
                raise ConfigError(
                    f"predictor of the form {content['format']!r}; expected {FORMAT!r}; export it "
                    "again"
                )
            tuples = {name: tuple(v) for name, v in content.items() if isinstance(v, list)}
            return cls(**{**content, **tuples})
        except (ValueError, KeyError, TypeError) as problem:
            if isinstance(problem, ConfigError):
                raise
            raise ConfigError(f"no metadata of a navlearn predictor ({problem})") from None


def describe(fitted: FittedErrorModel) -> PredictorMetadata:
    """Return what a predictor made of a fitted model says about itself.

    Args:
        fitted: The model with its training record.

    Raises:
        ConfigError: The record names no inputs or outputs, or an input whose unit is not known.
    """
    record = fitted.record
    model: Any = fitted.model
    source = record.source
    known = ERROR_UNITS | INPUT_UNITS
    units = source.input_units or tuple(known.get(name, "") for name in source.inputs)
    unknown = [name for name, unit in zip(source.inputs, units, strict=True) if not unit]
    if unknown or not source.inputs or not source.outputs:
        raise ConfigError(
            f"the model's record names the inputs {list(source.inputs)} and the outputs "
            f"{list(source.outputs)}; a predictor needs both named, inputs with their units "
            f"(input_units of the TrainingSource) or among {', '.join(INPUT_UNITS)}"
        )
    return PredictorMetadata(
        format=FORMAT,
        kind=fitted.kind,
        acts_on=source.acts_on,
        inputs=source.inputs,
        input_units=units,
        outputs=source.outputs,
        output_units=(OUTPUT_UNITS[source.acts_on],) * len(source.outputs),
        time_step_s=source.time_step,
        memory=int(model.memory),
        trained_on={
            "logs": list(source.logs),
            "regime": source.regime,
            "time_span_s": list(record.time_span),
            "samples": record.samples,
            "validation_samples": record.validation_samples,
            "trainer": record.trainer,
            "loop": record.loop,
            "iterations": record.iterations,
            "seed": record.seed,
            "train_loss": _plain(record.train_loss),
            "valid_loss": _plain(record.valid_loss),
        },
        versions=dict(record.versions),
    )


def _plain(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON does not have."""
    return value if value == value else None
