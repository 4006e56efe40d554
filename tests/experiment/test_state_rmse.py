"""Filters over whole drives, state by state."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.state_rmse import RECEIVER, SETTLE, drive_errors, drives_of, filters_of
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.state_errors import STATES, state_rmse
from navlearn.recipe import Recipe

SWEEP = {
    "name": "many",
    "sweep": {
        "type": "simulated",
        "grades": ["mems_m"],
        "drives": 3,
        "first_seed": 11,
        "duration_s": 300,
        "profile": "town",
    },
    "methods": ["dead_reckoning", "ekf", "ukf", "ins_ekf"],
    "calibration": {"odometer_latency": 0, "gnss_latency": 0},
}


def recipe_of(*methods: str) -> Recipe:
    content = {"name": "one", "log": {"path": "a"}, "methods": list(methods)}
    return Recipe.model_validate(content)


def test_every_filter_is_judged_at_the_same_times(short_drive: DriveLog) -> None:
    recipe = recipe_of("dead_reckoning", "ekf", "ukf", "ekf_plain", "ins_ekf")
    assert filters_of(recipe) == ("ekf", "ukf", "ekf_plain", "ins_ekf")
    errors = drive_errors(short_drive, recipe)
    assert list(dict.fromkeys(errors["solution"])) == [RECEIVER, *filters_of(recipe)]
    times = errors.groupby("solution")["t"].apply(list)
    assert times["ekf"] == times["ukf"] == times["ins_ekf"]
    assert times["ekf"][0] > SETTLE
    assert set(times[RECEIVER]) < set(times["ekf"])
    rmse = state_rmse(errors, "ekf").pivot_table(index="state", columns="solution", values="rmse")
    assert (rmse.loc[["latitude", "longitude"], "ekf"] < 5.0).all()
    assert 0.0 < rmse.loc["azimuth", "ekf"] < 5.0
    for speed in ("east velocity", "north velocity"):
        assert rmse.loc[speed, "ekf"] < 0.5
        # means over intervals of a tenth of a second are judged in their middle
        assert rmse.loc[speed, "ins_ekf"] < 0.5


def test_velocity_is_judged_in_the_middle_of_the_interval(short_drive: DriveLog) -> None:
    found = drive_errors(short_drive, recipe_of("ekf"), settle=100.0)
    truth = short_drive.reference
    assert truth is not None
    push = np.gradient(truth["v_e"], truth["t"])
    mine = found[found["solution"] == "ekf"]
    errors = mine["east velocity"].to_numpy()
    acceleration = np.interp(mine["t"], truth["t"], push)
    # an error of half an interval of a tenth of a second would be −0.05 s per m/s²
    slope = float(errors @ acceleration / (acceleration @ acceleration))
    assert abs(slope) < 0.02


def test_what_cannot_be_judged_is_refused(short_drive: DriveLog) -> None:
    with pytest.raises(ConfigError, match="none of its methods is a filter"):
        drive_errors(short_drive, recipe_of("dead_reckoning"))
    bare = short_drive.with_tables({"reference": None})
    with pytest.raises(LogError, match="need a reference"):
        drive_errors(bare, recipe_of("ekf"))


def test_drives_of_a_sweep_are_counted_by_class(tmp_path: Path) -> None:
    path = tmp_path / "many.yaml"
    path.write_text(yaml.safe_dump(SWEEP), encoding="utf-8")
    drives = list(drives_of(path, 100.0, 2))
    assert [one.group for one in drives] == ["M", "M"]
    assert [one.log.metadata.name[-2:] for one in drives] == ["11", "12"]
    (other,) = drives_of(path, 100.0, 1, 14)
    assert other.log.metadata.name.endswith("14")
    errors = drive_errors(drives[0].log, drives[0].recipe, ("ekf",))
    assert set(STATES) < set(errors.columns)
    assert errors["drive"].unique().tolist() == [drives[0].log.metadata.name]
