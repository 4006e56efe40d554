"""Recipes: one question, one drive, its methods and its protocol.

A recipe names one log, model specs, an outage protocol and training options; every key that it
leaves out has a default, and :meth:`Recipe.resolved` writes all of them down.
"""

import platform
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, Field, model_validator

from navlearn.errors import ConfigError
from navlearn.logs.nearest import nearest_hint
from navlearn.outages.schedule import parse_outages
from navlearn.recipe.filter_options import checked_filter, ekf_options
from navlearn.recipe.fixed_methods import BASELINES, FIXED_METHODS
from navlearn.recipe.sections import (
    CalibrationSection,
    LogSource,
    MechanizationSection,
    OutageSection,
    TrainingSection,
)
from navlearn.recipe.spec import BUILT_IN, ModelSpec, load_spec
from navlearn.recipe.spec_base import PlainName, Seed
from navlearn.recipe.strict import Section, parse
from navlearn.recipe.yaml_file import YamlFile, read_yaml

if TYPE_CHECKING:
    from navlearn.fusion.options import EkfOptions

ANY_ODOMETER: Final = ("scale", "delay", "offset")
"""Odometer errors that the filter estimates where nothing is known of the odometer."""

DEFAULT_METHODS: Final = ("dead_reckoning", "ekf_plain", "ekf", "anarx")

_VERSIONS: Final = "versions"


class Recipe(Section):
    """One experiment, complete.

    Attributes:
        name: Short name, used for files.
        question: The question that the recipe answers, in one sentence.
        log: The drive.
        models: Specs of the error models.
        methods: What is compared: names of :data:`FIXED_METHODS`, of ``models``, and of models
            that are built in.
        mechanization: How the car is dead-reckoned.
        filter: Options of the filter that differ from their defaults, by name.
        outages: Where GNSS is taken away.
        training: What error models learn from.
        calibration: How late streams are stamped.
        seed: Seed of everything that is drawn and has no seed of its own.
    """

    name: PlainName
    question: str = ""
    log: LogSource
    models: tuple[ModelSpec, ...] = ()
    methods: Annotated[tuple[str, ...], Field(min_length=1)] = BASELINES
    mechanization: MechanizationSection = MechanizationSection()
    filter: Annotated[dict[str, Any], AfterValidator(checked_filter)] = Field(default_factory=dict)
    outages: OutageSection = OutageSection()
    training: TrainingSection = TrainingSection()
    calibration: CalibrationSection = CalibrationSection()
    seed: Seed = 0

    @model_validator(mode="before")
    @classmethod
    def _built_in_models(cls, content: Any) -> Any:
        """Add the specs of models that a method's name alone calls for."""
        if not isinstance(content, dict) or not isinstance(content.get("methods"), list | tuple):
            return content
        given = content.get("models", ())
        if not isinstance(given, list | tuple):
            return content
        names = [_name_of(one) for one in given]
        called = [spec for spec in BUILT_IN.values() if spec.name not in names]
        called = [spec for spec in called if spec.name in content["methods"]]
        return {**content, "models": [*given, *called]} if called else content

    @model_validator(mode="after")
    def _methods_exist(self) -> "Recipe":
        names = [spec.name for spec in self.models]
        for name in names:
            if name in FIXED_METHODS:
                raise ValueError(f"a model cannot be named {name!r}: that method needs no model")
            if names.count(name) > 1:
                raise ValueError(f"two models are named {name!r}; give each its own name")
        known = list(dict.fromkeys([*FIXED_METHODS, *BUILT_IN, *names]))
        for method in self.methods:
            if method not in known:
                raise ValueError(
                    f"unknown method {method!r}{nearest_hint(method, known)}; "
                    f"known: {', '.join(known)}, and the models of specs under 'models'"
                )
            if self.methods.count(method) > 1:
                raise ValueError(f"the method {method!r} is listed twice; list each once")
        return self

    def model(self, name: str) -> ModelSpec:
        """Return the spec of a model by its name."""
        return next(spec for spec in self.models if spec.name == name)

    def ekf_options(self) -> "EkfOptions":
        """Return the filter's options: their defaults under the recipe's ``filter``."""
        return ekf_options(self.filter)

    def resolved(self) -> dict[str, Any]:
        """Return the recipe with every default written out, and the versions that made it.

        The mapping holds plain values and absolute paths; written as YAML and loaded again it
        gives an equal recipe.
        """
        return {**self.model_dump(mode="json"), _VERSIONS: _versions()}


def load_recipe(path: str | Path) -> Recipe:
    """Read a recipe; paths in it are relative to its own folder.

    Args:
        path: A YAML file such as ``training/first_look.yaml``, or a run's resolved recipe.

    Raises:
        LogNotFoundError: The recipe or a spec that it names does not exist.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="recipe")
    content = {key: value for key, value in file.content.items() if key != _VERSIONS}
    if "log" not in content and {"format", "path"} <= content.keys():
        raise ConfigError(
            f"{path}: this is the descriptor of a log, not a recipe; give it to navlearn evaluate, "
            "or name it under 'log' in a recipe"
        )
    if isinstance(content.get("models"), list):
        content["models"] = [
            _spec_entry(entry, file, i) for i, entry in enumerate(content["models"])
        ]
    if isinstance(content.get("log"), dict):
        content["log"] = _absolute(content["log"], file)
    return parse(Recipe, content, file=file)


def recipe_for(
    log: str | Path,
    format: str | None = None,
    *,
    outages: str = "10x60",
    methods: Sequence[str] = DEFAULT_METHODS,
    models: Sequence[str | Path] = (),
    **sections: Any,
) -> Recipe:
    """Return the recipe that ``navlearn evaluate`` runs on a log.

    Args:
        log: Log file or folder; a ``.yaml`` file is taken for a descriptor.
        format: Reader of the log; None for navlearn's own or a descriptor.
        outages: Count and length, such as "10x60": ten outages of 60 s.
        methods: Names of :data:`FIXED_METHODS`, of built-in models, and of models in ``models``.
        models: Spec files of further models.
        **sections: Further entries of :class:`Recipe`, as plain values; ``outages`` options
            beside count and length go into ``outage_options``. Without a ``filter`` of its own
            the filter also estimates delay and offset of an odometer of which nothing is known.

    Raises:
        ConfigError: Something is not understood or not allowed.
    """
    count, duration = parse_outages(outages)
    specs = [load_spec(path) for path in models]
    protocol = {"count": count, "duration_s": duration, **sections.pop("outage_options", {})}
    content = {
        "name": re.sub(r"[^A-Za-z0-9_.-]", "_", Path(log).stem).lstrip("_.-") or "evaluation",
        "question": f"How do {', '.join(methods)} compare through {protocol['count']} GNSS outages "
        f"of {protocol['duration_s']:g} s?",
        "log": _source(Path(log), format),
        "models": [spec.model_dump() for spec in specs],
        "methods": list(methods),
        "outages": protocol,
        "filter": {"speed_terms": list(ANY_ODOMETER)},
        **sections,
    }
    return parse(Recipe, content, file="evaluate")


def _name_of(spec: Any) -> Any:
    return spec.get("name") if isinstance(spec, dict) else getattr(spec, "name", None)


def _source(log: Path, format: str | None) -> dict[str, Any]:
    if format is None and _is_yaml(log.name):
        return {"descriptor": log.resolve()}
    layout = str(Path(format).resolve()) if format and _is_yaml(format) else format
    return {"path": log.resolve(), "format": layout}


def _spec_entry(entry: Any, file: YamlFile, index: int) -> Any:
    """Return a model entry as a mapping, reading the spec file that it names."""
    if not isinstance(entry, str):
        return entry
    path = file.path.parent / entry
    if not path.is_file():
        raise ConfigError(
            f"{file.where(('models', index))}: there is no model spec {entry!r} "
            f"(looked for {path}); paths are relative to the recipe"
        )
    return load_spec(path).model_dump()


def _absolute(source: Mapping[str, Any], file: YamlFile) -> dict[str, Any]:
    """Return the log's entries with paths that do not depend on where they are read from."""
    placed = dict(source)
    keys = ["descriptor", "path"]
    if _is_yaml(placed.get("format")):
        keys.append("format")
    for key in keys:
        if isinstance(placed.get(key), str):
            try:
                path = (file.path.parent / placed[key]).resolve()
            except (ValueError, RuntimeError):
                where = file.where(("log", key))
                raise ConfigError(f"{where}: {placed[key]!r} cannot be a path") from None
            placed[key] = str(path)
    return placed


def _is_yaml(name: object) -> bool:
    return isinstance(name, str) and name.lower().endswith((".yaml", ".yml"))


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in ("navlearn", "torch", "numpy", "pandas", "lightning"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found
