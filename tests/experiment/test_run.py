"""Whole runs: repeatable, resumable, and nothing left behind where they are refused."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import torch

from navlearn.error_models.storage import load_error_model
from navlearn.errors import ConfigError, LogError, OutputExistsError
from navlearn.experiment import run as run_module
from navlearn.experiment import run_recipe, train_recipe
from navlearn.experiment.anarx_method import AnarxMethod
from navlearn.export.example import load_example
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe, load_recipe

MakeRecipe = Callable[..., Recipe]
METHODS = ("ekf", "tiny")


class KilledError(BaseException):
    """The process ends here."""


def kill_at(monkeypatch: pytest.MonkeyPatch, outage_start: float) -> list[float]:
    """Let the learned method die at an outage; return the outages that it was asked for."""
    asked: list[float] = []
    whole = AnarxMethod.predict

    def predict(self: AnarxMethod, log: DriveLog, outage: Outage) -> Solution:
        asked.append(outage.start)
        if outage.start == outage_start:
            raise KilledError
        return whole(self, log, outage)

    monkeypatch.setattr(AnarxMethod, "predict", predict)
    return asked


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_error_model(folder / "models" / "tiny.pt").model.state_dict()


def same_run(one: Path, other: Path) -> None:
    first, second = ((folder / "outages.csv").read_bytes() for folder in (one, other))
    assert first == second
    for (name, a), b in zip(weights(one).items(), weights(other).values(), strict=True):
        assert torch.equal(a, b), name
    examples = [load_example(folder / "models" / "tiny_example.pt") for folder in (one, other)]
    assert torch.equal(*examples)


@pytest.fixture(scope="module")
def whole_run(make_recipe: MakeRecipe, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    result = run_recipe(make_recipe(methods=METHODS), folder, progress=False)
    assert list(result.table["method"]) == ["ekf", "ekf", "tiny", "tiny"]
    assert (result.table["failure"] == "").all()
    return folder


def test_a_run_killed_on_its_way_goes_on_and_ends_like_a_whole_one(
    make_recipe: MakeRecipe, whole_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe, folder = make_recipe(methods=METHODS), tmp_path / "run"
    with monkeypatch.context() as patch:
        kill_at(patch, 420.0)
        with pytest.raises(KilledError):
            run_recipe(recipe, folder, progress=False)
    with monkeypatch.context() as patch:
        asked = kill_at(patch, -1.0)
        run_recipe(recipe, folder, progress=False)
    assert asked == [420.0]  # the first came from the store
    same_run(folder, whole_run)
    with pytest.raises(OutputExistsError, match="finished run"):
        run_recipe(recipe, folder, progress=False)


def test_a_run_killed_before_its_report_still_has_its_models(
    make_recipe: MakeRecipe, whole_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe, folder = make_recipe(methods=METHODS), tmp_path / "run"

    def die(*_: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(run_module, "write_results", die)
        with pytest.raises(KilledError):
            run_recipe(recipe, folder, progress=False)
    with monkeypatch.context() as patch:
        asked = kill_at(patch, -1.0)
        run_recipe(recipe, folder, progress=False)
    assert asked == []
    same_run(folder, whole_run)


def test_force_starts_a_killed_run_afresh(
    make_recipe: MakeRecipe, whole_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe, folder = make_recipe(methods=METHODS), tmp_path / "run"
    shutil.copytree(whole_run, folder)
    (folder / "solutions" / "half.part").write_bytes(b"half a file")
    with monkeypatch.context() as patch:
        kill_at(patch, 420.0)
        with pytest.raises(KilledError):
            run_recipe(recipe, folder, force=True, progress=False)
    with monkeypatch.context() as patch:
        asked = kill_at(patch, -1.0)
        run_recipe(recipe, folder, force=True, progress=False)
    assert asked == [340.0, 420.0]
    assert len(list((folder / "solutions").iterdir())) == 4
    same_run(folder, whole_run)


def test_the_recipe_in_the_folder_is_the_one_that_ran(
    make_recipe: MakeRecipe, whole_run: Path
) -> None:
    assert load_recipe(whole_run / "recipe.yaml") == make_recipe(methods=METHODS)
    table = pd.read_csv(whole_run / "outages.csv")
    assert table["start_s"].tolist() == [340.0, 420.0] * 2


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"filter": {"model": "shen2010_full"}}, ConfigError, "carries velocity as a state"),
        ({"times_s": (340.0, 350.0)}, (ConfigError, LogError), "350"),
        ({"times_s": (340.0, 4000.0)}, (ConfigError, LogError), "4000"),
    ],
)
def test_a_refused_recipe_leaves_no_folder(
    make_recipe: MakeRecipe,
    tmp_path: Path,
    change: dict[str, object],
    error: type[Exception] | tuple[type[Exception], ...],
    said: str,
) -> None:
    recipe = make_recipe(methods=METHODS)
    if "filter" in change:
        recipe = make_recipe(methods=METHODS, **change)
    else:
        outages = recipe.outages.model_copy(update=change)
        recipe = recipe.model_copy(update={"outages": outages})
    with pytest.raises(error, match=said):
        run_recipe(recipe, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_a_log_that_cannot_be_used_leaves_no_folder(
    make_recipe: MakeRecipe, short_drive: DriveLog, tmp_path: Path
) -> None:
    recipe = make_recipe(methods=METHODS)
    parked = short_drive.odometer.assign(speed=0.0)
    save_log(replace(short_drive, odometer=parked), tmp_path / "parked")
    source = recipe.log.model_copy(update={"path": tmp_path / "parked"})
    recipe = recipe.model_copy(update={"log": source})
    with pytest.raises(LogError, match="alignment"):
        train_recipe(recipe, tmp_path / "trained", progress=False)
    assert not (tmp_path / "trained").exists()


def test_training_on_a_whole_drive_and_loading_what_it_left(
    make_recipe: MakeRecipe, tmp_path: Path
) -> None:
    recipe = make_recipe(methods=METHODS)
    trained = train_recipe(recipe, tmp_path / "one", progress=False)
    again = train_recipe(recipe, tmp_path / "two", progress=False)
    loaded = load_error_model(trained.folder / "models" / "tiny.pt")
    example = load_example(trained.folder / "models" / "tiny_example.pt")
    model = trained.models["tiny"].fitted.model
    assert torch.equal(example, trained.models["tiny"].example)
    assert torch.equal(loaded.model(example), model(example))
    record = trained.models["tiny"].fitted.record  # the last fit had nothing to validate on
    assert replace(loaded.record, valid_loss=0.0) == replace(record, valid_loss=0.0)
    assert loaded.record.source.logs == ("short",)
    assert 400.0 < loaded.record.time_span[1] <= 460.0
    for (name, a), b in zip(
        weights(trained.folder).items(), weights(again.folder).values(), strict=True
    ):
        assert torch.equal(a, b), name
    assert load_recipe(trained.folder / "recipe.yaml") == recipe


def test_training_without_a_model_is_refused(make_recipe: MakeRecipe, tmp_path: Path) -> None:
    recipe = make_recipe(methods=("ekf",)).model_copy(update={"models": ()})
    with pytest.raises(ConfigError, match="names no models"):
        train_recipe(recipe, tmp_path / "none", progress=False)
    assert not (tmp_path / "none").exists()
