"""Oracles: better than the filter in the order of what they know, and refused where none knows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.baselines import FilterRuns
from navlearn.experiment.drive import prepare_log
from navlearn.experiment.methods import build_methods
from navlearn.experiment.oracles import GyroOracle, PerfectAzimuth, gyro_noise, truth_for
from navlearn.experiment.perfect_azimuth import known_azimuth, reckoned
from navlearn.experiment.run import method_settings, run_recipe
from navlearn.filters.belief import map_belief
from navlearn.frames import enu_between
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.options import EkfOptions
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import GRADES, SimulatedDrive, simulate_drive
from navlearn.logs.synthetic.degrade import degraded_drive
from navlearn.outages.known_log import known_log
from navlearn.outages.replay import replay
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe, recipe_for
from navlearn.states import NavState, RissSample

METHODS = ("ekf", "oracle", "noise_free_gyro", "perfect_azimuth")


def drive_of(grade: str, seed: int) -> SimulatedDrive:
    name = f"{grade}_{seed}"
    return simulate_drive(
        profile="mixed", grade=grade, duration=1200.0, seed=seed, imu_rate_hz=10.0, name=name
    )


def recipe_of(methods: tuple[str, ...] = METHODS, folder: str = "nowhere") -> Recipe:
    return recipe_for(
        folder,
        outages="5x60",
        methods=methods,
        outage_options={"warm_up_s": 500.0, "min_gap_s": 10.0},
        filter={},
    )


def rows_of(drive: SimulatedDrive) -> pd.DataFrame:
    recipe = recipe_of()
    ready = prepare_log(drive.log, recipe)
    truth = truth_for(recipe, ready.log, drive.sensor_truth)
    methods = build_methods(recipe, truth=truth, runs=FilterRuns(recipe, growing=True))
    return replay(ready.log, ready.placement.outages, methods, progress=False).rows


@pytest.mark.parametrize("grade", ["mems_l", "mems_x"])
def test_who_knows_more_is_better_on_average(grade: str) -> None:
    rows = pd.concat([rows_of(drive_of(grade, seed)) for seed in (11, 12)])
    mean = rows.groupby("method")["max_horizontal_error_m"].mean()
    assert mean["oracle"] < 0.8 * mean["ekf"]
    assert mean["noise_free_gyro"] < mean["oracle"]
    assert mean["perfect_azimuth"] < mean["ekf"]
    azimuth = rows[rows["method"] == "perfect_azimuth"]["max_azimuth_error_deg"]
    assert azimuth.max() < 1.0


def test_with_ideal_sensors_there_is_nothing_to_know() -> None:
    mean = rows_of(drive_of("ideal", 11)).groupby("method")["max_horizontal_error_m"].mean()
    assert mean.max() < 0.3
    assert mean.max() - mean.min() < 0.25


def test_the_oracle_is_told_the_noise_of_the_data_sheet() -> None:
    drive = drive_of("mems_l", 13)
    found, grade = gyro_noise(drive.log, drive.sensor_truth), GRADES["mems_l"].gyro
    walk = np.radians(grade.angle_random_walk_deg_per_sqrt_h) / 60.0
    assert found.random_walk == pytest.approx(walk, rel=0.05)
    # Within a minute the Gauss–Markov bias and the random walk add up.
    per_h = np.radians(1.0) / 3600.0
    markov = grade.bias_instability_deg_per_h * per_h
    change = 2.0 * markov**2 * (1.0 - np.exp(-60.0 / grade.correlation_time))
    change += 60.0 * (grade.rate_random_walk_deg_per_h_per_sqrt_h * per_h / 60.0) ** 2
    assert found.drift == pytest.approx(np.sqrt(change / 60.0), rel=0.5)


def test_only_the_added_error_is_taken_off_a_degraded_drive() -> None:
    clean = drive_of("tactical", 14)
    worse = degraded_drive(clean.log, "mems_x", seed=3)
    recipe = recipe_of(("ekf", "oracle", "noise_free_gyro"))
    ready = prepare_log(worse.log, recipe)
    truth = truth_for(recipe, ready.log, worse.truth)
    known = known_log(ready.log, ready.placement.outages[0])
    runs = FilterRuns(recipe)
    GyroOracle(runs, truth, noise_free=True).predict(known, ready.placement.outages[0])
    (made,) = runs._made.values()
    alone = known_log(clean.log, ready.placement.outages[0])
    own, _, _ = FilterRuns(recipe).run(alone)
    torch.testing.assert_close(made.timeline.samples.yaw_rate, own.samples.yaw_rate)


def circle(azimuth_0: float) -> tuple[RissSample, torch.Tensor, float, float]:
    dt, v, rate, count = 0.1, 12.0, 0.08, 700
    t = torch.arange(1, count + 1, dtype=torch.float64) * dt
    each = torch.full((count,), dt, dtype=torch.float64)
    zero = torch.zeros_like(each)
    samples = RissSample(each, -rate + zero, v + zero, zero, zero, zero, zero, zero)
    return samples, azimuth_0 + rate * (t - 0.5 * dt), v / rate, float(rate * t[-1])


def test_an_odometer_on_a_circle_by_its_closed_form() -> None:
    samples, middle, radius, turned = circle(0.3)
    # On the equator: elsewhere a circle does not close in longitude, by its area over the Earth.
    state = NavState(*(torch.tensor(x, dtype=torch.float64) for x in (0.0, -1.2, 70.0, 9.9)))
    options = EkfOptions()
    belief = initial_belief(options, state, sensor={"speed_scale": 0.0}, sigmas={})
    way = reckoned(options, belief, samples, middle)
    east, north, up = enu_between(
        way.lat[-1], way.lon[-1], way.height[-1], state.lat, state.lon, state.height
    )
    assert float(east) == pytest.approx(radius * (np.cos(0.3) - np.cos(0.3 + turned)), abs=2e-3)
    assert float(north) == pytest.approx(radius * (np.sin(0.3 + turned) - np.sin(0.3)), abs=2e-3)
    assert float(up) == 0.0
    assert float(way.azimuth[-2]) == pytest.approx(0.3 + turned - 0.008, abs=1e-9)


def test_the_odometer_is_corrected_by_what_the_filter_knows() -> None:
    samples, middle, _, _ = circle(0.0)
    straight = torch.zeros_like(middle)
    options = EkfOptions()
    state = NavState(*(torch.tensor(x, dtype=torch.float64) for x in (0.8, -1.2, 70.0, 0.0)))
    belief = initial_belief(options, state, sensor={}, sigmas={})
    slow = map_belief(belief, torch.clone)
    slow.sensor[1] = 0.02  # bias, scale, pitch
    still = samples._replace(yaw_rate=torch.zeros_like(straight))
    ways = [reckoned(options, one, still, straight).lat[-1] - state.lat for one in (belief, slow)]
    assert float(ways[0] / ways[1]) == pytest.approx(1.02, rel=1e-9)


def test_an_oracle_is_refused_before_anything_runs(tmp_path: Path) -> None:
    drive = drive_of("mems_m", 15)
    folder = save_log(drive.log, tmp_path / "drive")
    recipe = recipe_of(("ekf", "oracle"), str(folder))
    with pytest.raises(ConfigError, match="oracle needs a simulated drive"):
        run_recipe(recipe, tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
    with pytest.raises(ConfigError, match="needs a simulated drive"):
        build_methods(recipe)
    with pytest.raises(ConfigError, match="needs a reference"):
        PerfectAzimuth(FilterRuns(recipe), None)


def test_a_run_with_oracles_reads_what_lies_beside_the_log(tmp_path: Path) -> None:
    drive = drive_of("mems_x", 15)
    folder = save_log(drive.log, tmp_path / "drive", truth=drive.sensor_truth)
    result = run_recipe(recipe_of(METHODS, str(folder)), tmp_path / "run", progress=False)
    mean = result.table.groupby("method")["max_horizontal_error_m"].mean()
    assert mean["oracle"] < mean["ekf"]
    about = result.summary["methods"]
    assert {about[name]["training_regime"] for name in METHODS[1:]} == {"oracle"}


def test_no_azimuth_no_perfect_azimuth() -> None:
    drive = drive_of("mems_m", 16)
    assert drive.log.reference is not None
    poor = replace(drive.log, reference=drive.log.reference[["t", "lat", "lon"]])
    assert known_azimuth(track_of(poor)) is None
    with pytest.raises(ConfigError, match="reference with azimuth or velocity"):
        truth_for(recipe_of(("ekf", "perfect_azimuth")), poor, None)
    course = replace(drive.log, reference=drive.log.reference.drop(columns=["azimuth"]))
    truth = truth_for(recipe_of(("ekf", "perfect_azimuth")), course, None)
    assert truth is not None
    assert truth.azimuth is not None
    assert truth_for(recipe_of(("ekf",)), course, drive.sensor_truth) is None


def test_another_truth_makes_stored_solutions_void() -> None:
    drive, other = drive_of("mems_m", 16), drive_of("mems_l", 16)
    recipe = recipe_of(("ekf", "oracle"))
    first, second = (
        method_settings(recipe, (), truth_for(recipe, one.log, one.sensor_truth))
        for one in (drive, other)
    )
    assert first["ekf"] == second["ekf"]
    assert first["oracle"] != second["oracle"]
    with pytest.raises(LogError, match="belongs to another drive"):
        truth_for(
            recipe,
            drive.log.between(0.0, 9.0),
            replace(drive.sensor_truth, t=other.log.imu["t"].to_numpy() + 0.05),
        )
