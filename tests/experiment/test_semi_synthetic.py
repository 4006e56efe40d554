"""A recipe that spoils a good gyro says so, and prints the paper's table beside its own."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from navlearn.experiment.drive import open_log, sensor_truth_of
from navlearn.experiment.run import run_recipe
from navlearn.logs.drive_log import DriveLog
from navlearn.recipe import Recipe, load_recipe
from navlearn.recipe.log_section import GyroErrorSection

MakeRecipe = Callable[..., Recipe]


def spoilt(recipe: Recipe, seed: int = 3) -> Recipe:
    log = recipe.log.model_copy(update={"gyro": GyroErrorSection(grade="mems_l", seed=seed)})
    return recipe.model_copy(update={"log": log})


def test_the_gyro_of_a_recipes_log_is_spoilt_as_stated(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(methods=("ekf",))
    once, again, other = (open_log(spoilt(recipe, seed)) for seed in (3, 3, 4))
    added = (once.imu["gyro_z"] - short_drive.imu["gyro_z"]).to_numpy()
    assert np.abs(added).max() > 1e-3
    np.testing.assert_array_equal(once.imu["gyro_z"], again.imu["gyro_z"])
    assert not once.imu["gyro_z"].equals(other.imu["gyro_z"])
    assert once.metadata.extra["semi_synthetic"]["grade"] == "mems_l"
    assert sensor_truth_of(spoilt(recipe)) is not None
    assert open_log(recipe).imu["gyro_z"].equals(short_drive.imu["gyro_z"])


@pytest.mark.filterwarnings("ignore:filter. .*NIS:UserWarning")
def test_the_report_says_what_was_done_and_what_the_paper_printed(
    make_recipe: MakeRecipe, tmp_path: Path
) -> None:
    table = {
        "source": "Shen2010", "caption": "Mean maximum", "columns": ["method", "m"],
        "rows": [["KF only", "78.10"], ["KF/FOS", "26.31"]], "remark": "another drive",
    }  # fmt: skip
    recipe = make_recipe(
        methods=("ekf", "ekf_shen2010", "shen2010"),
        published=[table],
        remarks=["Not the drive of the paper."],
        metric="rms_horizontal_error_m",
    )
    result = run_recipe(spoilt(recipe), tmp_path / "run", progress=False)
    report = (tmp_path / "run" / "report.md").read_text(encoding="utf-8")
    head = report.split("**Question.**")[0]
    assert "> Not the drive of the paper." in head
    assert "> Semi-synthetic" in head
    assert "`mems_l` (seed 3)" in head
    assert "| KF/FOS | 26.31 |" in report
    assert "another drive" in report
    assert "`rms_horizontal_error_m`" in report
    assert load_recipe(result.folder / "recipe.yaml") == spoilt(recipe)
    assert set(result.table["method"]) == {"ekf", "ekf_shen2010", "shen2010"}
