"""Runs a recipe: log, filter, fit, replay, report."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch
import yaml

from navlearn.error_models.storage import save_error_model
from navlearn.errors import ConfigError, LogNotFoundError
from navlearn.experiment.baselines import PLAIN, filter_options
from navlearn.experiment.drive import prepare_drive, sensor_truth_of
from navlearn.experiment.learned import Learned
from navlearn.experiment.methods import build_methods
from navlearn.experiment.oracles import GYRO_ORACLES, Truth, truth_for
from navlearn.experiment.run_chapters import run_chapters
from navlearn.experiment.sensors_needed import check_sensors
from navlearn.experiment.summary import run_summary
from navlearn.experiment.tuned_elsewhere import check_tuned
from navlearn.export.example import save_example
from navlearn.outages.fit_diagnostics import FitDiagnostics
from navlearn.outages.maps import Scene
from navlearn.outages.output import OutputFolder, prepare_output_folder
from navlearn.outages.replay import replay
from navlearn.outages.results import write_results
from navlearn.outages.tables import summary_content
from navlearn.recipe import Recipe
from navlearn.recipe.fixed_methods import FIXED_METHODS
from navlearn.recipe.ingredients import ingredients_of
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.range_error_spec import RangeErrorSpec


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What a run leaves.

    Attributes:
        folder: The run's folder.
        table: A row per outage and method, as ``outages.csv``.
        summary: The content of ``summary.json``.
    """

    folder: Path
    table: pd.DataFrame
    summary: Mapping[str, Any]


def check_recipe(recipe: Recipe) -> None:
    """Refuse a recipe whose filter leaves its error models nothing to act on.

    Args:
        recipe: The recipe.

    Raises:
        ConfigError: The filter's model has no plain mechanization, or its errors are not fed back.
    """
    full = [spec for spec in recipe.models if isinstance(spec, InsAnarxSpec)]
    coasting = [spec.name for spec in full if spec.mode == "sound"]
    if coasting and recipe.ins_filter.get("feedback") == "open":
        raise ConfigError(
            f"recipe {recipe.name}: {', '.join(coasting)} learns how the filter's own estimate "
            "coasts, which an open loop never takes up; leave ins_filter.feedback closed"
        )
    elsewhere = (InsAnarxSpec, RangeErrorSpec)
    names = ", ".join(spec.name for spec in recipe.models if not isinstance(spec, elsewhere))
    if names and filter_options(recipe).has_velocity_states:
        raise ConfigError(
            f"recipe {recipe.name}: {names} corrects a mechanization, but the filter's model "
            f"{recipe.filter['model']} carries velocity as a state; take another filter model or "
            "leave the error models out"
        )


def run_recipe(
    recipe: Recipe, out: Path, *, force: bool = False, progress: bool = True
) -> RunResult:
    """Run a recipe and write its folder.

    An interrupted run goes on where it stopped when it is started again. Each model is saved
    whenever it is fitted, before the solution that it made; the last outage's is what stays.

    Args:
        recipe: The recipe.
        out: Folder for the run.
        force: Replace an earlier run there.
        progress: Show a progress bar.

    Returns:
        The run's folder and tables.

    Raises:
        OutputExistsError: The folder holds a finished run, or files that no run wrote.
        LogError: The log cannot be used, or the outages do not fit into it; no folder is made.
        ConfigError: Parts of the recipe do not go together; no folder is made.
    """
    check_recipe(recipe)
    drive = prepare_drive(recipe)
    check_sensors(recipe, drive.log, drive.placement.outages)
    check_tuned(recipe, drive.log, drive.placement.outages)
    truth = truth_for(recipe, drive.log, sensor_truth_of(recipe))
    output = prepare_output_folder(Path(out), force)
    resolved = recipe.resolved()
    text = yaml.safe_dump(resolved, sort_keys=False, allow_unicode=True)
    output.claim("recipe.yaml").write_text(text, encoding="utf-8")
    torch.manual_seed(recipe.seed)
    fits: dict[str, FitDiagnostics] = {}
    methods = build_methods(recipe, partial(save_learned, output), truth, diagnose=fits.__setitem__)
    found = replay(
        drive.log,
        drive.placement.outages,
        methods,
        store=output.claim("solutions/"),
        settings=method_settings(recipe, drive.notes, truth),
        progress=progress,
    )
    summary = replace(
        run_summary(recipe, drive, found, resolved["versions"], output.path),
        chapters=run_chapters(recipe, drive, fits, output),
    )
    scene = Scene(log=drive.log, outages=drive.placement.outages, replay=found)
    summary = write_results(output, summary, [scene])
    output.finish()
    return RunResult(folder=output.path, table=summary.rows, summary=summary_content(summary))


def method_settings(
    recipe: Recipe, notes: tuple[str, ...], truth: Truth | None
) -> dict[str, object]:
    """Return per method all that its solutions depend on beside log and outage.

    Args:
        recipe: The recipe.
        notes: What was done to the drive's clocks.
        truth: What oracles are handed.
    """
    shared = {
        "mechanization": recipe.mechanization.model_dump(mode="json"),
        "filter": json.loads(json.dumps(recipe.filter, default=str)),
        "ins_filter": json.loads(json.dumps(recipe.ins_filter, default=str)),
        "tight": json.loads(json.dumps(recipe.tight, default=str)),
        "clocks": list(notes),
        "seed": recipe.seed,
    }
    settings: dict[str, object] = {}
    for name in recipe.methods:
        if name in FIXED_METHODS:
            settings[name] = {**shared, "model": PLAIN.get(name, name), **_stated(recipe, name)}
            if name in GYRO_ORACLES and truth is not None and truth.gyro is not None:
                settings[name] = {**shared, "model": name, "gyro": truth.gyro.fingerprint()}
        else:
            spec = recipe.model(name)
            settings[name] = {
                **shared,
                "model": spec.model_dump(mode="json"),
                "trained": "".join(digest_of(path) for path in spec.files()),
                "training": recipe.training.model_dump(mode="json"),
            }
    return settings


def _stated(recipe: Recipe, method: str) -> dict[str, object]:
    """Return the sections of a recipe that a method's ingredients are stated in."""
    return {
        section: recipe.model_dump(mode="json")[section]
        for section, taken in ingredients_of(method)._asdict().items()
        if taken
    }


def digest_of(path: Path) -> str:
    """Return a hash of the file of a trained model.

    Args:
        path: The file.

    Raises:
        LogNotFoundError: There is no such file.
    """
    if not path.is_file():
        raise LogNotFoundError(
            f"{path}: no such file; 'trained' names a model that navlearn train wrote"
        )
    return hashlib.sha256(path.read_bytes()).hexdigest()


def save_learned(output: OutputFolder, name: str, learned: Learned) -> None:
    """Write a fitted model and an example of its regressors into a run's folder.

    What an earlier fit left there is replaced.

    Args:
        output: The run's folder.
        name: The model's name.
        learned: The model.
    """
    save_error_model(learned.fitted, output.claim(f"models/{name}.pt"), force=True)
    save_example(learned.example, output.claim(f"models/{name}_example.pt"))
