"""The filter with more gyro terms as a method: gate, refusal, causality, temperature."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.experiment.augmented_filter import augmented_run
from navlearn.experiment.augmented_method import AugmentedMethod, midway, places
from navlearn.experiment.baselines import FilterMethod, FilterRuns, filter_options
from navlearn.experiment.drive import set_clocks
from navlearn.fusion.options import EkfOptions
from navlearn.learning.pseudo_outages import PseudoOutageOptions, emulate_outages
from navlearn.logs.synthetic import simulate_drive
from navlearn.navigator import belief_at
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.recipe.spec_base import SafeguardSpec
from navlearn.states import Trajectory

OUTAGE = Outage(start=400.0, duration=30.0)
WIDE_OPEN = SafeguardSpec(gate=False)


@pytest.fixture(scope="module")
def drive():
    """A gyro whose scale is 3 % off, and that warms up by 9 K."""
    return simulate_drive(
        profile="town", grade="mems_x", duration=440.0, seed=11, imu_rate_hz=10.0, name="warm"
    )


@pytest.fixture(scope="module")
def runs(make_recipe):
    return FilterRuns(make_recipe(methods=("ekf",)))


@pytest.fixture(scope="module")
def log(drive, runs):
    return known_log(set_clocks(drive.log, runs.recipe, OUTAGE.start)[0], OUTAGE)


def spec(**changes):
    return AugmentedSpec(name="augmented", judge_s=20.0, judge_every_s=5.0, **changes)


def test_where_it_helped_it_takes_over_and_tells_what_it_found(drive, runs, log):
    solution = AugmentedMethod(runs, spec()).predict(log, OUTAGE)
    assert solution.notes["used"] is True
    assert solution.notes["gate_improvement_percent"] > 5.0
    assert solution.notes["gate_replays"] > 20
    told = solution.notes["parameters"]
    assert set(told) == set(AugmentedSpec(name="x").gyro_terms)
    for term, key, factor in (
        ("scale", "scale_factor", 100.0),
        ("temperature", "temperature", np.degrees(3600.0)),
    ):
        value, sigma = map(float, re.match(r"(\S+) ± (\S+)", told[term]).groups())
        true = factor * drive.gyro_errors.coefficients[key]
        # random walks of the bias look like warming, so twice as much is left to temperature
        assert abs(value - true) < (6.0 if term == "temperature" else 3.0) * sigma, term
    honest = FilterMethod(runs, "ekf").predict(log, OUTAGE)
    assert not np.allclose(solution.table["lat"], honest.table["lat"], atol=1e-9, rtol=0.0)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"safeguard": SafeguardSpec(gate_margin=0.99)}, "99 % on at least 5 asked for"),
        ({"safeguard": SafeguardSpec(gate_fewest=10**6)}, "on at least 1000000 asked for"),
        ({"judge_after_s": 390.0}, "emulated outages"),
    ],
)
def test_where_refused_the_answer_is_the_filters_to_the_last_bit(runs, log, changes, reason):
    solution = AugmentedMethod(runs, spec(**changes)).predict(log, OUTAGE)
    assert solution.notes["used"] is False
    assert reason in solution.notes["reason"]
    honest = FilterMethod(runs, "ekf").predict(log, OUTAGE)
    pd.testing.assert_frame_equal(solution.table, honest.table, check_exact=True)


@pytest.mark.parametrize("thermometer", [True, False])
def test_without_temperature_it_is_the_filter_with_those_states(runs, log, thermometer):
    terms = ("bias", "scale", "temperature")
    if thermometer:
        terms = terms[:2]
    else:
        log = log.with_tables({"imu": log.imu.drop(columns="temperature")})
    mine = spec(gyro_terms=terms, safeguard=WIDE_OPEN)
    solution = AugmentedMethod(runs, mine).predict(log, OUTAGE)
    options = mine.filter_options(filter_options(runs.recipe, log=log))
    assert options.gyro_terms == ("bias", "scale")
    _, _, run = runs.run(log, options)
    t = runs.run(log)[0].t[run.first :].numpy()
    at = np.searchsorted(t, solution.table["t"].to_numpy())
    assert np.array_equal(run.history.trajectory.lat[at].numpy(), solution.table["lat"].to_numpy())
    assert set(solution.notes["parameters"]) == {"bias", "scale"}


def test_nothing_that_a_fix_says_later_moves_what_was_judged(runs, log):
    """What coasts from a start rests on nothing later, in the past of an outage too."""
    part = known_log(log, Outage(start=300.0, duration=20.0))
    whole, early = (augmented_run(runs, one, spec()) for one in (log, part))
    block = torch.tensor([100, 180, 250])
    assert float(whole.run.history.end[250]) < 2990
    for a, b in zip(whole.belief(block).state, early.belief(block).state, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=1e-8)
    rows = whole.run.history.end[block].unsqueeze(-1) + 1 + torch.arange(100)
    # the fast form of the filter is converged to a fraction of a millimetre
    paths = zip(whole.coast(block, rows), early.coast(block, rows), strict=True)
    for (a, b), close in zip(paths, (1e-9, 1e-9, *5 * (1e-5,)), strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=close)


def test_both_filters_coast_from_the_same_starts(runs, log):
    _, navigator, run = runs.run(log)
    outages = emulate_outages(navigator, run, PseudoOutageOptions(horizon=20.0), end=3900)
    block, rows = places(outages, run)
    assert torch.equal(outages.samples.yaw_rate, run.samples.yaw_rate[rows])
    for mine, theirs in zip(belief_at(run.history, block).state, outages.belief.state, strict=True):
        assert torch.equal(mine, theirs)


def test_the_reference_is_as_far_from_one_as_from_the_other():
    one = Trajectory(*(torch.tensor([1.0, 2.0]) for _ in Trajectory._fields))
    other = Trajectory(*(torch.tensor([3.0, 6.0]) for _ in Trajectory._fields))
    assert torch.equal(midway(one, other).lat, torch.tensor([2.0, 4.0]))


def test_the_spec_makes_the_filter():
    honest = EkfOptions()
    options = AugmentedSpec(name="a").filter_options(honest)
    assert options.gyro_terms == ("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y")
    assert options.noise.turn_noise == 0.003
    assert options.standstill == 1.0
    forces = AugmentedSpec(name="a", gyro_terms=("bias", "f_x")).filter_options(honest)
    assert forces.noise == honest.noise
    quiet = replace(honest, noise=replace(honest.noise, turn_noise=0.001))
    assert AugmentedSpec(name="a").filter_options(quiet).noise.turn_noise == 0.001
    with pytest.raises(ValueError, match="add 'bias'"):
        AugmentedSpec(name="a", gyro_terms=("scale",))
    with pytest.raises(ValueError, match="name each term once"):
        AugmentedSpec(name="a", gyro_terms=("bias", "bias"))
