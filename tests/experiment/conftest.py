"""A short simulated drive on disk, and a recipe for it with a tiny network."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe import Recipe, recipe_for

TINY = """
name: tiny
acts_on: ACTS_ON
inputs: [yaw_rate, speed, delay]
lags: 1
hidden: 2
max_iterations: 3
starts: 1
objective: step
ridge: 1.0e-4
safeguard: {gate: GATE}
"""

MakeRecipe = Callable[..., Recipe]


@pytest.fixture(scope="session")
def short_drive() -> DriveLog:
    return simulate_drive(
        profile="town", grade="mems_x", duration=460.0, seed=7, imu_rate_hz=20.0, name="short"
    ).log


@pytest.fixture(scope="session")
def drive_folder(short_drive: DriveLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "short"
    save_log(short_drive, folder)
    return folder


@pytest.fixture(scope="session")
def make_recipe(drive_folder: Path) -> MakeRecipe:
    """A recipe of two outages of 20 s; the network learns from emulated ones of 15 s."""

    def make(
        methods: tuple[str, ...] = ("dead_reckoning", "ekf_plain", "ekf", "tiny"),
        acts_on: str = "position",
        gate: bool = False,
        **sections: Any,
    ) -> Recipe:
        spec = drive_folder.parent / f"tiny_{acts_on}_{gate}.yaml"
        content = TINY.replace("ACTS_ON", acts_on).replace("GATE", str(gate).lower())
        spec.write_text(content, encoding="utf-8")
        return recipe_for(
            drive_folder,
            methods=methods,
            models=[spec],
            outages="2x20",
            outage_options={"warm_up_s": 330.0, "placement": "listed", "times_s": [340.0, 420.0]},
            **{"training": {"horizon_s": 15.0, "gap_s": 5.0, "settle_s": 30.0}, **sections},
        )

    return make
