"""Recipes and sweeps hand the satellites of their drives to the simulator."""

from typing import Any

import pandas as pd

from navlearn.experiment.drive import open_log
from navlearn.experiment.sweep_drives import make_drive
from navlearn.logs.synthetic import PRESETS, simulate_drive
from navlearn.recipe import Recipe
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe

MADE: dict[str, Any] = {"profile": "town", "duration_s": 60.0, "imu_rate_hz": 10.0}


def expected(**changes: Any) -> pd.DataFrame:
    asked: dict[str, Any] = {"profile": "town", "duration": 60.0, "imu_rate_hz": 10.0, "seed": 11}
    found = simulate_drive(**(asked | changes)).log.ranges
    assert found is not None
    return found


def test_a_recipe_simulates_ranges() -> None:
    entry = {**MADE, "seed": 11, "satellites": {"preset": "urban", "systems": ["G", "E"]}}
    recipe = parse(Recipe, {"name": "r", "log": {"simulated": entry}}, file="test")
    log = open_log(recipe)
    assert log.ranges is not None
    assert {"G", "E"} == set(log.ranges["satellite"].str[0])
    del entry["satellites"]
    bare = parse(Recipe, {"name": "r", "log": {"simulated": entry}}, file="test")
    assert open_log(bare).ranges is None


def test_a_sweep_simulates_ranges() -> None:
    content = {
        "name": "s",
        "sweep": {
            "type": "simulated",
            "grades": ["mems_m"],
            "drives": 1,
            "first_seed": 11,
            "sky": "suburban",
            **MADE,
        },
    }
    log, _ = make_drive(parse(SweepRecipe, content, file="test"), "mems_m", 11)
    assert log.ranges is not None
    pd.testing.assert_frame_equal(log.ranges, expected(satellites=PRESETS["suburban"]))
