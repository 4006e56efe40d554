"""Noise found by likelihood: known noise, bad starts, resuming, what cannot be told, bad input."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from navlearn.errors import ConfigError, LogError, OutputExistsError
from navlearn.fusion.noise import log_noise, noise_from_log
from navlearn.fusion.noise_options import NoiseOptions
from navlearn.fusion.options import EkfOptions
from navlearn.learning import noise_tuning
from navlearn.learning.drive_likelihood import DriveLikelihood, TuningDrive, by_window
from navlearn.learning.held_out import HeldOutStretch, held_out_scores
from navlearn.learning.noise_objective import NoiseObjective
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import (
    FreeParameters,
    default_names,
    known_names,
    unit_of,
)
from navlearn.learning.noise_tuning import tune_noise
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.figures import GnssGrade, GyroGrade, OdometerGrade, SensorGrade
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix

KNOWN = SensorGrade(
    name="known",
    summary="white errors alone",
    gyro=GyroGrade(
        bias_deg_per_s=0.1,
        rate_random_walk_deg_per_h_per_sqrt_h=60.0,
        angle_random_walk_deg_per_sqrt_h=1.2,
    ),
    odometer=OdometerGrade(scale_factor_percent=1.0),
    gnss=GnssGrade(noise=2.0, velocity_noise=0.1),
)
FLAT = EkfOptions(mechanization=RissOptions(dimensions=2))
FREE = ("position_inflation", "velocity_inflation", "hill_walk")
# of a fix, all but the inflations: what is left is the receiver's own deviation
BARE = replace(
    FLAT.noise,
    position_walk=1e-3,
    position_floor=0.01,
    height_floor=0.01,
    velocity_floor=0.003,
    speed_noise=0.003,
)


@pytest.fixture(scope="module")
def log() -> DriveLog:
    return simulate_drive(
        profile="mixed", grade=KNOWN, duration=300.0, seed=12, imu_rate_hz=5.0
    ).log


@pytest.fixture(scope="module")
def known(log: DriveLog) -> TuningDrive:
    line = riss_timeline(log, rate_hz=5.0)
    return TuningDrive("known", line.samples, line.fixes, line.timing)


@pytest.fixture(scope="module")
def drawn(log: DriveLog) -> tuple[float, float]:
    """Errors that the fixes of this drive happen to have, over what their receiver tells."""
    fixes, truth = log.fixes, log.reference
    at = {name: np.interp(fixes["t"], truth["t"], truth[name]) for name in truth if name != "t"}
    radius = 6.371e6
    north = (fixes["lat"] - at["lat"]) * radius / 2.0
    east = (fixes["lon"] - at["lon"]) * radius * np.cos(at["lat"]) / 2.0
    up = (fixes["height"] - at["height"]) / 3.2
    speed = [(fixes[name] - at[name]) / 0.1 for name in ("v_e", "v_n")]
    return float(np.std([north, east, up])), float(np.std(speed))


def _times(factor: float) -> EkfOptions:
    moved = {name: factor * getattr(BARE, name) for name in FREE}
    return replace(FLAT, noise=replace(BARE, **moved))


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_known_noise_is_found_from_bad_starts(known, drawn, factor):
    tuning = TuningOptions(free=FREE, iterations=30)
    found = tune_noise([known], _times(factor), tuning, progress=False)
    assert found.converged
    assert found.gain > 100.0
    position, velocity, _ = found.figures.entries
    assert position.told
    assert velocity.told
    for one, true in zip((position, velocity), drawn, strict=True):
        assert true == pytest.approx(1.0, rel=0.1)
        assert abs(math.log(one.after / true)) < 3.0 * one.error
        assert one.after == pytest.approx(1.0, rel=0.12)
    level = found.figures.fixes[0]
    assert level.after == pytest.approx(2.0 * position.after, rel=1e-3)
    assert level.before == pytest.approx(3.0 * factor, rel=1e-2)
    # of n normal values a deviation is known to 1/√(2 n); fixes have three axes
    count = 3 * int((known.timing.index >= 0).sum())
    assert 0.7 < position.error * math.sqrt(2.0 * count) < 2.5


def test_what_a_drive_does_not_tell_stays_where_it_was(known):
    noise = replace(_times(1.0).noise, position_walk=1e-9)
    free = ("position_walk", "position_inflation")
    tuning = TuningOptions(free=free, iterations=10)
    found = tune_noise([known], replace(FLAT, noise=noise), tuning, progress=False)
    walk = found.figures.entries[0]
    assert not walk.told
    assert walk.after == pytest.approx(1e-9, rel=0.01)
    assert abs(walk.curvature) < 0.01
    assert walk.error == pytest.approx(math.log(10.0), rel=0.01)


def test_an_interrupted_search_ends_where_an_uninterrupted_one_does(known, tmp_path):
    start = _times(3.0)
    whole = tune_noise([known], start, TuningOptions(free=FREE[:2]), progress=False)
    short = TuningOptions(free=FREE[:2], iterations=3)
    first = tune_noise([known], start, short, folder=tmp_path, progress=False)
    assert not first.converged
    assert first.iterations == 3
    with pytest.raises(OutputExistsError, match="resume"):
        tune_noise([known], start, TuningOptions(free=FREE[:2]), folder=tmp_path, progress=False)
    told = f"other data or options.*delete {re.escape(str(tmp_path))} to start anew"
    with pytest.raises(ConfigError, match=told):
        tune_noise([known], FLAT, TuningOptions(free=FREE[:2]), folder=tmp_path, resume=True)
    rest = tune_noise(
        [known], start, TuningOptions(free=FREE[:2]), folder=tmp_path, resume=True, progress=False
    )
    assert rest.iterations == whole.iterations
    for name, value in whole.values.items():
        assert rest.values[name] == pytest.approx(value, rel=1e-5)


def test_the_gradient_is_that_of_differences_also_of_initial_deviations(known):
    parameters = FreeParameters(_times(1.0), ("position_inflation", "initial.speed.scale"))
    objective = NoiseObjective(
        [DriveLikelihood(known, parameters.options)], parameters, TuningOptions()
    )
    logs = parameters.start + 0.3
    objective.judge(logs)
    here = objective(logs)
    for i in range(2):
        step = torch.zeros(2, dtype=torch.float64)
        step[i] = 1e-3
        slope = (objective(logs + step).value - objective(logs - step).value) / 2e-3
        assert float(here.gradient[i]) == pytest.approx(slope, rel=1e-3, abs=1e-3)


def test_held_out_likelihood_prefers_the_noise_that_is_true(known):
    true, wrong = _times(1.0), _times(3.0)
    drive = HeldOutStretch(drive=known, after=180.0)
    same = held_out_scores([drive], true, true, window=30.0)
    assert torch.equal(same.before, same.after)
    assert float(same.seconds.sum()) == pytest.approx(300.0 - 180.0, abs=2.0)
    found = held_out_scores([drive], wrong, true, window=30.0)
    assert float((found.after - found.before).min()) > 0.0
    with pytest.raises(LogError, match="nothing is left"):
        held_out_scores([replace(drive, after=1e4)], true, true)


def test_windows_hold_every_block_once():
    time = torch.arange(1.0, 100.0, dtype=torch.float64)
    by_kind = torch.rand(1, 99, 5, dtype=torch.float64)
    sums, seconds = by_window(time, by_kind, 20.0, 10.0)
    assert torch.allclose(sums.sum(0), by_kind[0, 10:].sum(0))
    assert seconds.tolist() == [20.0, 20.0, 20.0, 29.0]


def test_names_are_those_of_the_model():
    flat = known_names(FLAT)
    assert {"hill_walk", "initial.speed.scale"} <= set(flat)
    assert not {"height_walk", "zero_speed", "initial.gyro.bias"} & set(flat)
    shen = EkfOptions(model="shen2010_full")
    assert {"velocity_walk", "zero_speed", "initial.acceleration_bias"} <= set(known_names(shen))
    still = replace(FLAT, noise=replace(FLAT.noise, turn_noise=0.0))
    assert "turn_noise" not in default_names(still)
    assert all(unit_of(name) for options in (FLAT, shen) for name in known_names(options))


def test_tuned_options_hold_what_was_found():
    names = ("hill_walk", "initial.speed.scale")
    parameters = FreeParameters(FLAT, names)
    found = parameters.tuned(parameters.start + math.log(2.0))
    assert found.noise.hill_walk == pytest.approx(2.0 * FLAT.noise.hill_walk)
    assert found.initial.speed["scale"] == pytest.approx(2.0 * FLAT.initial.speed["scale"])
    assert found.initial.gyro == FLAT.initial.gyro
    logs = torch.log(torch.tensor([5.0, 0.1], dtype=torch.float64))
    direct = noise_from_log(log_noise(replace(NoiseOptions(), hill_walk=5.0)))
    assert torch.allclose(torch.stack(parameters.noise(logs)), torch.stack(direct))


def test_what_cannot_be_tuned_is_said(known):
    with pytest.raises(ConfigError, match="nothing that this filter uses"):
        tune_noise([known], FLAT, TuningOptions(free=("height_walk",)))
    still = replace(FLAT, noise=replace(FLAT.noise, turn_noise=0.0))
    with pytest.raises(ConfigError, match="is zero"):
        tune_noise([known], still, TuningOptions(free=("turn_noise",)))
    with pytest.raises(ConfigError, match="each once"):
        tune_noise([known], FLAT, TuningOptions(free=("hill_walk", "hill_walk")))
    with pytest.raises(ConfigError, match="found no drive"):
        tune_noise([], FLAT)
    with pytest.raises(ConfigError, match="feedback"):
        tune_noise([known], replace(FLAT, feedback="open"))
    with pytest.raises(ConfigError, match="prior_factor"):
        TuningOptions(prior_factor=1.0)
    with pytest.raises(ConfigError, match="rounds"):
        TuningOptions(rounds=0)
    fixes = GnssFix(*(x[:25] for x in known.fixes))
    few = known._replace(fixes=fixes, timing=FixTiming(*(x[:25] for x in known.timing)))
    with pytest.raises(LogError, match="known"):
        tune_noise([few], FLAT)


class Interrupted(Exception):
    """What stops a search from outside."""


def test_interrupted_in_a_later_round_a_search_ends_alike(known, tmp_path, monkeypatch):
    # wild fixes pull the first verdicts, which believe all, away from the gate's
    wild = known.fixes.lat.clone()
    wild[::9] += 40.0 / 6.371e6
    known = known._replace(fixes=known.fixes._replace(lat=wild))
    start, tuning = _times(1.0), TuningOptions(free=FREE[:1], tolerance=1e-3)
    kept, places = noise_tuning._kept, []

    def watched(path, mark, search):
        kept(path, mark, search)
        places.append((search.round, search.steps_in_round))

    monkeypatch.setattr(noise_tuning, "_kept", watched)
    whole = tune_noise([known], start, tuning, folder=tmp_path / "whole", progress=False)
    stop = max(k for k, (number, steps) in enumerate(places) if number == 1 and steps > 0)
    places.clear()

    def stopping(path, mark, search):
        watched(path, mark, search)
        if len(places) == stop + 1:
            raise Interrupted

    monkeypatch.setattr(noise_tuning, "_kept", stopping)
    with pytest.raises(Interrupted):
        tune_noise([known], start, tuning, folder=tmp_path / "part", progress=False)
    rest = tune_noise([known], start, tuning, folder=tmp_path / "part", resume=True, progress=False)
    assert (rest.rounds, rest.iterations) == (whole.rounds, whole.iterations)
    for name, value in whole.values.items():
        assert rest.values[name] == pytest.approx(value, rel=1e-5)
