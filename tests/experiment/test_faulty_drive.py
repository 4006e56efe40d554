"""A recipe whose log has faults put in."""

from dataclasses import replace

import pandas as pd
import pytest

from navlearn.errors import LogError
from navlearn.experiment.drive import open_log
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.recipe import Recipe

SIMULATED = {"grade": "mems_m", "duration_s": 600.0, "imu_rate_hz": 10.0, "seed": 11}
FAULTS = {"spikes": {"per_hour": 120}, "seed": 4}


def recipe(**log):
    return Recipe.model_validate({"name": "faulty", "log": log})


def test_fixes_alone_are_touched():
    clean = open_log(recipe(simulated=SIMULATED))
    faulty = open_log(recipe(simulated=SIMULATED, faults=FAULTS))
    table = injected_faults(faulty)
    assert len(table) > 3
    changed = faulty.fixes["lat"] != clean.fixes["lat"]
    assert changed.sum() == len(table)
    for name in ("imu", "odometer", "reference"):
        pd.testing.assert_frame_equal(faulty.tables()[name], clean.tables()[name])


def test_raw_ranges_stay_as_they_are():
    sky = {**SIMULATED, "satellites": "open_sky", "duration_s": 240.0}
    log = open_log(recipe(simulated=sky))
    made = open_log(recipe(simulated=sky, faults=FAULTS))
    assert not made.fixes["lat"].equals(log.fixes["lat"])
    pd.testing.assert_frame_equal(made.ranges, log.ranges)


def test_a_log_judged_by_its_fixes_gets_no_faults(tmp_path):
    log = simulate_drive(duration=240.0, seed=11, imu_rate_hz=10.0).log
    save_log(replace(log, reference=None), tmp_path / "drive")
    with pytest.raises(LogError, match="no reference"):
        open_log(recipe(path=tmp_path / "drive", format="native", faults=FAULTS))
