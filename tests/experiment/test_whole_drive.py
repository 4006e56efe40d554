"""Solutions over a whole drive, and where it was in a canyon."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.experiment.whole_drive import in_canyon, recorded_drives, summary, whole_drive
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe import Recipe

ROOT = Path(__file__).resolve().parents[2]


def test_errors_are_those_against_the_truth() -> None:
    drive = simulate_drive(
        profile="mixed",
        grade="mems_m",
        duration=240.0,
        seed=12,
        imu_rate_hz=10.0,
        satellites="suburban",
    )
    recipe = Recipe.model_validate({"name": "one", "log": {"path": "a"}, "methods": ["tc_ekf"]})
    errors = whole_drive(drive.log, recipe)
    assert set(errors["solution"]) == {
        "single point",
        "receiver's fixes",
        "loose, receiver's fixes",
        "loose, single point",
        "tight",
    }
    fixes, truth = drive.log.fixes, drive.log.reference
    assert truth is not None
    lat = np.interp(fixes["t"], truth["t"], truth["lat"])
    north = 6.371e6 * (fixes["lat"].to_numpy() - lat)
    own = errors[errors["solution"] == "receiver's fixes"]
    told = np.interp(fixes["t"], own["t"], own["north"])
    assert np.abs(told - north).max() < 0.01 + 0.01 * np.abs(north).max()
    figures = summary(errors).set_index(["where", "solution"])
    for where, solution in (("all", "tight"), ("all", "single point")):
        off = errors.loc[errors["solution"] == solution, "horizontal"]
        assert figures.loc[(where, solution), "median"] == pytest.approx(np.median(off))
        assert figures.loc[(where, solution), "times"] == len(off)
    assert figures.loc[("all", "tight"), "95 %"] < 10.0


def test_a_canyon_is_where_few_satellites_are_received_or_none() -> None:
    t = np.arange(0.0, 100.0)
    many = [(at, f"G{k:02d}") for at in t for k in range(8 if at < 50 else 4)]
    gap = [row for row in many if not 20 <= row[0] < 40]
    drive = simulate_drive(
        profile="mixed", grade="mems_m", duration=60.0, seed=12, imu_rate_hz=10.0
    )
    log = replace(drive.log, ranges=pd.DataFrame(gap, columns=["t", "satellite"]))
    found = in_canyon(log, np.array([10.0, 30.0, 45.1, 70.0]))
    assert found.tolist() == [False, True, False, True]
    assert not in_canyon(replace(drive.log, ranges=None), t).any()


def test_drives_of_recipes_and_sweeps() -> None:
    training = ROOT / "training"
    (kingston,) = recorded_drives(training / "iqbal2020_pci_pseudorange.yaml")
    assert kingston.log.descriptor is not None
    assert kingston.log.descriptor.name == "kingston_2008.yaml"
    other = ROOT / "datasets" / "smartloc_rtklib.yaml"
    (changed,) = recorded_drives(training / "iqbal2020_pci_pseudorange_smartloc.yaml", other)
    assert changed.log.descriptor == other
    assert changed.tight == {"range_noise": {"multipath": 10.0, "multipath_time": 10.0}}
    with pytest.raises(ConfigError, match="its drives are simulated"):
        recorded_drives(training / "iqbal2020_pci_pseudorange_simulated.yaml")
