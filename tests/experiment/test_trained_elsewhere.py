"""Models fitted on other drives: used frozen, never on the drive they were fitted on."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import yaml

from navlearn.error_models.storage import load_error_model
from navlearn.errors import ConfigError
from navlearn.experiment import run_recipe, train_recipe
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe import Recipe, load_spec

MakeRecipe = Callable[..., Recipe]


@pytest.fixture(scope="module")
def frozen_spec(make_recipe: MakeRecipe, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A spec beside the model that it names by a relative path."""
    folder = tmp_path_factory.mktemp("elsewhere")
    recipe = make_recipe(methods=("ekf", "tiny"), acts_on="azimuth_rate")
    train_recipe(recipe, folder / "fitted", progress=False)
    content = recipe.model("tiny").model_dump(mode="json")
    content |= {"trained": "fitted/models/tiny.pt"}
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def on_other_drive(recipe: Recipe, spec: Path, folder: Path) -> Recipe:
    drive = simulate_drive(
        profile="town", grade="mems_x", duration=460.0, seed=8, imu_rate_hz=20.0, name="other"
    )
    save_log(drive.log, folder / "other")
    source = recipe.log.model_copy(update={"path": folder / "other"})
    return recipe.model_copy(update={"log": source, "models": (load_spec(spec),)})


def test_the_model_is_used_as_it_was_saved(
    make_recipe: MakeRecipe, frozen_spec: Path, tmp_path: Path
) -> None:
    recipe = on_other_drive(make_recipe(methods=("ekf", "tiny")), frozen_spec, tmp_path)
    found = run_recipe(recipe, tmp_path / "run", progress=False)
    used = load_error_model(found.folder / "models" / "tiny.pt")
    saved = load_error_model(frozen_spec.parent / "fitted" / "models" / "tiny.pt")
    for a, b in zip(used.model.parameters(), saved.model.parameters(), strict=True):
        assert torch.equal(a, b)
    assert used.record.source.logs == ("short",)
    assert used.record.source.regime == "other-drives"
    assert "other-drives" in (found.folder / "report.md").read_text(encoding="utf-8")
    errors = found.table.pivot(index="outage", columns="method", values="max_horizontal_error_m")
    assert (errors["ekf"] != errors["tiny"]).all()


def test_nothing_is_judged_on_what_it_was_fitted_to(
    make_recipe: MakeRecipe, frozen_spec: Path, tmp_path: Path
) -> None:
    recipe = make_recipe(methods=("ekf", "tiny"))
    recipe = recipe.model_copy(update={"models": (load_spec(frozen_spec),)})
    with pytest.raises(ConfigError, match="was trained on short itself"):
        run_recipe(recipe, tmp_path / "run", progress=False)


def test_a_model_of_another_job_is_refused(
    make_recipe: MakeRecipe, frozen_spec: Path, tmp_path: Path
) -> None:
    other = frozen_spec.parent / "other.yaml"
    text = frozen_spec.read_text(encoding="utf-8")
    other.write_text(text.replace("acts_on: azimuth_rate", "acts_on: position"), encoding="utf-8")
    recipe = on_other_drive(make_recipe(methods=("ekf", "tiny")), other, tmp_path)
    with pytest.raises(ConfigError, match="acts_on azimuth_rate, but tiny asks for position"):
        run_recipe(recipe, tmp_path / "run", progress=False)
