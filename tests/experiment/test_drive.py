"""Clocks of a recipe's drive: each latency by itself, from the past alone."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.drive import open_log, sensor_truth_of, set_clocks, timeline_of
from navlearn.logs.clock import without_latency
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import GRADES, jaradat2017_scenario, simulate_drive
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe, load_recipe

MakeRecipe = Callable[..., Recipe]
LATE = {"odometer": 0.4, "gnss": 0.25}


@pytest.fixture(scope="module")
def late() -> DriveLog:
    """Fixes 0.25 s and odometer 0.4 s late; the log states neither."""
    grade = GRADES["mems_m"]
    grade = replace(
        grade,
        odometer=replace(grade.odometer, latency=LATE["odometer"]),
        gnss=replace(grade.gnss, latency=LATE["gnss"]),
    )
    log = simulate_drive(profile="town", grade=grade, duration=900.0, seed=4, imu_rate_hz=20.0).log
    return stating(log)


def stating(log: DriveLog, **latencies: float) -> DriveLog:
    known = {"odometer_latency": 0.0, "gnss_latency": 0.0, **latencies}
    return replace(log, metadata=replace(log.metadata, **known))


def moved(before: DriveLog, after: DriveLog) -> tuple[float, float]:
    """Return what was taken off the times of fixes and odometer."""
    shifts = [
        float(np.mean(old["t"].to_numpy() - new["t"].to_numpy()))
        for old, new in ((before.fixes, after.fixes), (before.odometer, after.odometer))
    ]
    return shifts[0], shifts[1]


def test_both_are_estimated_where_nothing_is_stated(
    late: DriveLog, make_recipe: MakeRecipe
) -> None:
    log, notes = set_clocks(late, make_recipe(), 600.0)
    gnss, odometer = moved(late, log)
    assert gnss == pytest.approx(LATE["gnss"], abs=0.1)
    assert odometer == pytest.approx(LATE["odometer"], abs=0.1)
    assert log.metadata.latency_removed
    assert len(notes) == 2
    assert all("from the drive before 600 s" in note for note in notes)


@pytest.mark.parametrize("removed", [False, True])
def test_what_is_stated_is_taken_and_the_other_estimated(
    late: DriveLog, make_recipe: MakeRecipe, removed: bool
) -> None:
    stated = stating(late, gnss_latency=LATE["gnss"])
    log, notes = set_clocks(without_latency(stated) if removed else stated, make_recipe(), 600.0)
    gnss, odometer = moved(late, log)
    assert gnss == pytest.approx(LATE["gnss"], abs=1e-9)
    assert odometer == pytest.approx(LATE["odometer"], abs=0.1)
    assert "as the log's descriptor says" in notes[0]
    assert "from the drive" in notes[1]


@pytest.mark.parametrize("removed", [False, True])
def test_numbers_of_the_recipe_replace_those_of_the_log(
    late: DriveLog, make_recipe: MakeRecipe, removed: bool
) -> None:
    stated = stating(late, gnss_latency=0.1, odometer_latency=0.2)
    recipe = make_recipe(calibration={"gnss_latency": 0.25, "odometer_latency": 0.0})
    log, notes = set_clocks(without_latency(stated) if removed else stated, recipe, 600.0)
    assert moved(late, log) == pytest.approx((0.25, 0.0), abs=1e-9)
    assert (log.metadata.gnss_latency, log.metadata.odometer_latency) == (0.25, 0.0)
    # Reading the timeline takes nothing off a second time.
    used = timeline_of(log, recipe).fix_time.numpy()
    assert np.isin(used, log.fixes["t"].to_numpy()).all()
    assert all("as the recipe says" in note for note in notes)


def test_nothing_at_or_after_the_first_outage_is_used(
    late: DriveLog, make_recipe: MakeRecipe
) -> None:
    def spoilt(table: pd.DataFrame) -> pd.DataFrame:
        table = table.copy()
        table.loc[table["t"] >= 600.0, [name for name in table if name != "t"]] = 1e3
        return table

    assert late.reference is not None
    poisoned = replace(late, fixes=spoilt(late.fixes), reference=spoilt(late.reference))
    recipe = make_recipe()
    assert set_clocks(poisoned, recipe, 600.0)[1] == set_clocks(late, recipe, 600.0)[1]
    assert set_clocks(poisoned, recipe, 700.0)[1] != set_clocks(late, recipe, 700.0)[1]


def test_a_drive_cut_at_an_outage_reaches_its_end(
    short_drive: DriveLog, make_recipe: MakeRecipe
) -> None:
    """Odometer samples 2 s apart: the last before the end is held, as in a gap within."""
    sparse = replace(short_drive, odometer=short_drive.odometer.iloc[::20])
    cut = known_log(sparse, Outage(200.0, 61.8))
    line = timeline_of(cut, make_recipe())
    assert float(cut.odometer["t"].iloc[-1]) == pytest.approx(260.0)
    assert float(line.t[-1]) == pytest.approx(261.8)
    held = line.samples.speed[-18:]
    assert held.tolist() == pytest.approx([float(cut.odometer["speed"].iloc[-1])] * 18)


def test_a_recipe_may_simulate_its_drive(tmp_path: Path) -> None:
    def recipe(simulated: str) -> Recipe:
        path = tmp_path / "recipe.yaml"
        path.write_text(f"name: a\nlog: {{simulated: {simulated}}}\n", encoding="utf-8")
        return load_recipe(path)

    made = recipe("{profile: town, grade: tactical, duration_s: 60, imu_rate_hz: 20, seed: 11}")
    expected = simulate_drive(
        profile="town", grade="tactical", duration=60.0, imu_rate_hz=20.0, seed=11
    )
    pd.testing.assert_frame_equal(open_log(made).imu, expected.log.imu)
    assert sensor_truth_of(made).gyro_error.tolist() == expected.sensor_truth.gyro_error.tolist()
    scenario = open_log(recipe("{profile: jaradat2017, seed: 3}"))
    pd.testing.assert_frame_equal(scenario.fixes, jaradat2017_scenario(3).log.fixes)
    part = open_log(recipe("{profile: jaradat2017, seed: 3}, between_s: [20, 50]"))
    assert part.metadata.name == "jaradat2017_jaradat2017_3_20-50s"
    assert 20.0 <= part.imu["t"].min() < part.imu["t"].max() < 50.0
    assert part.metadata.start is None
    with pytest.raises(LogError, match=r"no IMU sample between 200 and 300 s"):
        open_log(recipe("{profile: jaradat2017, seed: 3}, between_s: [200, 300]"))
    with pytest.raises(ConfigError, match="between_s"):
        recipe("{profile: jaradat2017, seed: 3}, between_s: [50, 20]")
    with pytest.raises(ConfigError, match=r"unknown profile 'towns'.*town"):
        recipe("{profile: towns}")
