"""Recipes: one question, one drive, its methods and its protocol.

A recipe names one log, model specs, an outage protocol and training options; every key that it
leaves out has a default, and :meth:`Recipe.resolved` writes all of them down.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from navlearn.errors import ConfigError
from navlearn.outages.schedule import parse_outages
from navlearn.recipe.experiment_base import VERSIONS, Experiment, Titled
from navlearn.recipe.ingredients import without_tuned
from navlearn.recipe.log_section import LogSource
from navlearn.recipe.spec import load_spec
from navlearn.recipe.strict import parse
from navlearn.recipe.tuned_spec import read_tuned
from navlearn.recipe.yaml_file import KeyPath, YamlFile, read_yaml

ANY_ODOMETER: Final = ("scale", "delay", "offset")
"""Odometer errors that the filter estimates where nothing is known of the odometer."""

DEFAULT_METHODS: Final = ("dead_reckoning", "ekf_plain", "ekf", "anarx")


class OneLog(Titled):
    """What a recipe is run on.

    Attributes:
        log: The drive.
    """

    log: LogSource


class Recipe(Experiment, OneLog):
    """One experiment on one drive, complete."""


def load_recipe(path: str | Path, *, untuned: bool = False) -> Recipe:
    """Read a recipe; paths in it are relative to its own folder.

    Args:
        path: A YAML file such as ``training/first_look.yaml``, or a run's resolved recipe.
        untuned: Leave out what it says of tuning, and the methods that take it: a tuned spec may
            be made for a recipe that names it.

    Raises:
        LogNotFoundError: The recipe or a spec that it names does not exist.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="recipe")
    content = own_content(file, untuned=untuned)
    if "sweep" in content and "log" not in content:
        raise ConfigError(
            f"{path}: this is a sweep over many drives, not a recipe for one; give it to "
            "navlearn run, or load it with load_sweep"
        )
    if "log" not in content and {"format", "path"} <= content.keys():
        raise ConfigError(
            f"{path}: this is the descriptor of a log, not a recipe; give it to navlearn evaluate, "
            "or name it under 'log' in a recipe"
        )
    if isinstance(content.get("log"), dict):
        content["log"] = absolute_source(content["log"], file)
    return parse(Recipe, content, file=file)


def own_content(file: YamlFile, *, untuned: bool = False) -> dict[str, Any]:
    """Return what a recipe's file says itself, with the specs that it names read.

    Args:
        file: The file; the versions that a resolved recipe tells are left out.
        untuned: As in :func:`load_recipe`.

    Raises:
        ConfigError: A spec that it names does not exist or is wrong.
    """
    content = {key: value for key, value in file.content.items() if key != VERSIONS}
    if isinstance(content.get("models"), list):
        content["models"] = [
            _spec_entry(entry, file, i) for i, entry in enumerate(content["models"])
        ]
    if untuned:
        return without_tuned(content)
    if isinstance(content.get("tuned"), str):
        content["tuned"] = _tuned_entry(content["tuned"], file, ("tuned",))
    grades = content.get("tuned_by_grade")
    if isinstance(grades, dict):
        content["tuned_by_grade"] = {
            grade: _tuned_entry(entry, file, ("tuned_by_grade", grade))
            for grade, entry in grades.items()
        }
    return content


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


def _tuned_entry(entry: Any, file: YamlFile, key_path: KeyPath) -> Any:
    """Return what was tuned as a mapping, reading the spec file that is named."""
    if not isinstance(entry, str):
        return entry
    path = file.path.parent / entry
    if not path.is_file():
        raise ConfigError(
            f"{file.where(key_path)}: there is no tuned spec {entry!r} (looked for {path}); paths "
            "are relative to the recipe, and navlearn tune makes such a spec"
        )
    return read_tuned(path).model_dump()


def absolute_source(source: Mapping[str, Any], file: YamlFile) -> dict[str, Any]:
    """Return a log's entries with paths that do not depend on where they are read from.

    Args:
        source: The entries.
        file: Where they stand.

    Raises:
        ConfigError: Something cannot be a path.
    """
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
