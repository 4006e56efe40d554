"""Fits a recipe's error models on a whole drive, for use on another."""

from dataclasses import dataclass
from pathlib import Path

import torch
import yaml

from navlearn.errors import ConfigError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import open_log, set_clocks, timeline_of
from navlearn.experiment.learned import Learned, learn
from navlearn.experiment.run import check_recipe, save_learned
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.outages.output import prepare_output_folder
from navlearn.recipe import Recipe
from navlearn.recipe.anarx_spec import AnarxSpec


@dataclass(frozen=True, kw_only=True)
class TrainResult:
    """What training leaves.

    Attributes:
        folder: The folder with ``recipe.yaml`` and ``models/``.
        models: Fitted models and their verdicts, by name.
    """

    folder: Path
    models: dict[str, Learned]


def train_recipe(
    recipe: Recipe, out: Path, *, force: bool = False, progress: bool = True
) -> TrainResult:
    """Fit those models of a recipe on its whole drive that can be used on others: ANARX.

    Args:
        recipe: The recipe; its outages play no part.
        out: Folder for the models.
        force: Replace what an earlier run wrote there.
        progress: Show a progress bar.

    Returns:
        The folder and the models.

    Raises:
        ConfigError: The recipe has no such model, or its filter leaves one nothing to act on.
        FitError: The drive is too short to learn from.
        OutputExistsError: The folder holds a finished run, or files that no run wrote.
    """
    specs = [spec for spec in recipe.models if isinstance(spec, AnarxSpec)]
    if not specs:
        found = ", ".join(spec.name for spec in recipe.models) or "no models"
        raise ConfigError(
            f"recipe {recipe.name}: it names {found}; only models of type anarx are trained on "
            "one drive for use on another, the others learn on the drive itself: give "
            "them to navlearn evaluate"
        )
    check_recipe(recipe)
    log, _ = set_clocks(open_log(recipe), recipe, float("inf"))
    timeline = timeline_of(log, recipe)
    navigator = Navigator(NavigatorOptions(filter=filter_options(recipe, log=log)))
    run = navigator.run(timeline.samples, timeline.fixes, timeline.timing)
    output = prepare_output_folder(Path(out), force)
    text = yaml.safe_dump(recipe.resolved(), sort_keys=False, allow_unicode=True)
    output.claim("recipe.yaml").write_text(text, encoding="utf-8")
    torch.manual_seed(recipe.seed)
    models = {}
    for spec in specs:
        models[spec.name] = learn(
            recipe,
            spec,
            navigator,
            run,
            end=int(run.samples.dt.shape[-1]),
            begin=float(timeline.t[run.first] - run.samples.dt[0]),
            log_name=log.metadata.name,
            regime="other-drives",
            progress=progress,
        )
        save_learned(output, spec.name, models[spec.name])
    output.finish()
    return TrainResult(folder=output.path, models=models)
