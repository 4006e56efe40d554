"""A drive without a full IMU is refused before anything is run, and no folder is made."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.experiment import run_recipe
from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.sensors_needed import check_sensors, of_a_full_imu
from navlearn.experiment.sweep import run_sweep
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.recipe import Recipe
from navlearn.recipe.sweep import load_sweep

MakeRecipe = Callable[..., Recipe]
IMU = {"sensors": "imu"}


@pytest.fixture(scope="module")
def one_gyro(short_drive: DriveLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "one_gyro"
    save_log(replace(short_drive, imu=short_drive.imu[["t", "gyro_z"]]), folder)
    return folder


@pytest.mark.parametrize(
    ("methods", "sections", "needed"),
    [
        (("ekf", "ins_ekf_plain"), {}, ("ins_ekf_plain",)),
        (("ekf", "jaradat2017"), {}, ("jaradat2017",)),
        (("dead_reckoning", "ekf"), {"mechanization": IMU}, ("dead_reckoning",)),
        (("ekf",), {"mechanization": IMU, "observability": True}, ("observability",)),
        (("dead_reckoning", "ekf", "rts"), {"observability": True}, ()),
    ],
)
def test_what_a_recipe_needs_six_axes_for(
    make_recipe: MakeRecipe,
    methods: tuple[str, ...],
    sections: dict[str, object],
    needed: tuple[str, ...],
) -> None:
    assert of_a_full_imu(make_recipe(methods=methods, **sections)) == needed


def test_a_drive_with_one_gyro_is_refused_and_leaves_no_folder(
    make_recipe: MakeRecipe, one_gyro: Path, tmp_path: Path
) -> None:
    recipe = make_recipe(methods=("ekf", "ins_ekf"))
    recipe = recipe.model_copy(
        update={"log": recipe.log.model_copy(update={"path": one_gyro, "descriptor": None})}
    )
    with pytest.raises(LogError, match=r"ins_ekf cannot run: .*a full IMU needs gyro_x"):
        run_recipe(recipe, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_a_sweep_over_a_drive_with_one_gyro_is_refused(one_gyro: Path, tmp_path: Path) -> None:
    path = tmp_path / "swept.yaml"
    path.write_text(
        f"name: swept\nsweep: {{type: recorded, logs: [{{path: {one_gyro}}}]}}\n"
        "methods: [ins_ekf]\n",
        encoding="utf-8",
    )
    with pytest.raises(LogError, match="a full IMU needs"):
        run_sweep(load_sweep(path), tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_a_strapdown_faster_than_its_imu_is_refused(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(methods=("ins_ekf",), mechanization={"imu_rate_hz": 21.5})
    with pytest.raises(
        ConfigError, match=r"found 21\.5, but the IMU of short has 20 samples per s"
    ):
        check_sensors(recipe, short_drive)
    slower = make_recipe(methods=("ins_ekf",), mechanization={"imu_rate_hz": 20.0})
    check_sensors(slower, short_drive)


def test_a_hole_is_refused_up_to_the_end_of_the_last_outage(make_recipe: MakeRecipe) -> None:
    recipe = make_recipe(methods=("ins_ekf",))
    drive = prepare_drive(recipe)
    outages = drive.placement.outages
    t = drive.log.imu["t"]

    def without(begin: float) -> DriveLog:
        hole = t.between(begin, begin + 3.0)
        return replace(drive.log, imu=drive.log.imu[~hole].reset_index(drop=True))

    check_sensors(recipe, without(outages[-1].end + 1.0), outages)
    with pytest.raises(LogError, match=r"ins_ekf cannot run: .*gap"):
        check_sensors(recipe, without(outages[-1].start - 30.0), outages)
