"""Learning before an outage: parts that share nothing, the gate, and what is kept."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.error_models.anarx import Anarx
from navlearn.experiment.anarx_method import AnarxMethod, last_fix
from navlearn.experiment.baselines import FilterMethod, FilterRuns, filter_options
from navlearn.experiment.learned import (
    Learned,
    learn,
    pseudo_outage_options,
    split_by_time,
)
from navlearn.export import describe
from navlearn.export.reading import LoadedPredictor
from navlearn.export.replay import predict_drive
from navlearn.filters.belief import Belief
from navlearn.learning.pseudo_outages import PseudoOutages
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import check_solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.states import NavState, RissSample, Trajectory

MakeRecipe = Callable[..., Recipe]
OUTAGE = Outage(420.0, 20.0)


def emulated(starts: list[float], horizon: float) -> PseudoOutages:
    count = len(starts)
    zero = torch.zeros(count, 1, dtype=torch.float64)
    state = NavState(*(zero[:, 0] for _ in range(4)))
    path = Trajectory(*(zero for _ in range(7)))
    samples = RissSample(zero + horizon, *(zero for _ in range(7)))
    belief = Belief(state, zero, zero, zero, zero, zero)
    return PseudoOutages(belief, samples, path, path, torch.tensor(starts).double(), 1)


@settings(max_examples=60, deadline=None)
@given(
    starts=st.lists(st.integers(0, 4000), min_size=1, max_size=80, unique=True),
    horizon=st.sampled_from([10.0, 30.0, 60.0]),
    gap=st.sampled_from([0.0, 10.0, 45.0]),
)
def test_parts_share_no_second_and_keep_the_gap(
    starts: list[int], horizon: float, gap: float
) -> None:
    times = [float(t) for t in sorted(starts)]
    parts = split_by_time(emulated(times, horizon), gap)
    seen: set[int] = set()
    for earlier, later in itertools.pairwise(parts):
        if len(earlier) and len(later):
            ends = max(times[i] for i in earlier.tolist()) + horizon
            assert min(times[i] for i in later.tolist()) >= ends + gap
    for part in parts:
        assert seen.isdisjoint(part.tolist())
        seen |= set(part.tolist())
    train, _, judge = parts
    if len(train) and len(judge):
        assert max(times[i] for i in train.tolist()) + horizon <= times[int(judge[0])] - gap


def test_a_long_past_fills_all_three_parts() -> None:
    train, valid, judge = split_by_time(emulated([10.0 * k for k in range(60)], 60.0), 10.0)
    assert (len(train), len(valid), len(judge)) == (34, 7, 7)


def test_the_training_section_reaches_the_emulated_outages(make_recipe: MakeRecipe) -> None:
    recipe = make_recipe(
        training={
            "horizon_s": 20.0, "restart_every_s": 7.0, "step_s": 0.5, "window_s": 200.0,
            "minimum_distance": 33.0, "settle_s": 44.0,
        }
    )  # fmt: skip
    options = pseudo_outage_options(recipe)
    assert (options.horizon, options.every, options.step, options.window) == (20.0, 7.0, 0.5, 200.0)
    assert (options.minimum_distance, options.settle) == (33.0, 44.0)
    assert options.max_fix_interval == recipe.outages.max_fix_interval_s


def solve(recipe: Recipe, log: DriveLog) -> tuple[pd.DataFrame, dict[str, object], list[Learned]]:
    kept: list[Learned] = []
    method = AnarxMethod(FilterRuns(recipe), recipe.model("tiny"), lambda _, one: kept.append(one))
    found = method.predict(known_log(log, OUTAGE), OUTAGE)
    check_solution(found.table, OUTAGE)
    return found.table, dict(found.notes), kept


def filtered(recipe: Recipe, log: DriveLog) -> pd.DataFrame:
    return FilterMethod(FilterRuns(recipe), "ekf").predict(known_log(log, OUTAGE), OUTAGE).table


@pytest.mark.parametrize("acts_on", ["position", "azimuth_rate"])
def test_without_a_gate_the_model_acts_and_has_seen_the_whole_past(
    make_recipe: MakeRecipe, short_drive: DriveLog, acts_on: str
) -> None:
    recipe = make_recipe(acts_on=acts_on)
    table, notes, kept = solve(recipe, short_drive)
    assert notes["used"] is True
    assert "gate off" in str(notes["reason"])
    fitted, trial = kept[0].fitted.record, kept[0].trial
    assert fitted.samples > trial.samples + trial.validation_samples
    assert fitted.validation_samples == 0
    # On the log's own clock, and over before the outage.
    assert 30.0 < fitted.time_span[0] < 120.0
    assert 400.0 < fitted.time_span[1] < OUTAGE.start
    assert np.isfinite(float(str(notes["valid_loss"])))
    model = kept[0].fitted.model
    assert isinstance(model, Anarx)
    assert torch.isfinite(model.prediction_variance(1)).all()
    plain = filtered(recipe, short_drive)
    assert list(table.columns) == list(plain.columns)
    assert {"std_e", "std_n", "cov_en"} <= set(table.columns)
    assert np.isfinite(table.to_numpy()).all()
    assert (table["lat"] - plain["lat"]).abs().max() * 6.37e6 > 1e-3
    # Both start alike: the correction begins with the outage.
    assert (table["lat"] - plain["lat"]).abs().iloc[0] * 6.37e6 < 0.5


def test_a_refused_model_leaves_the_filter_as_it_is(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(gate=True)
    safeguard = recipe.model("tiny").safeguard.model_copy(update={"gate_margin": 0.99})
    spec = recipe.model("tiny").model_copy(update={"safeguard": safeguard})
    recipe = recipe.model_copy(update={"models": (spec,)})
    table, notes, kept = solve(recipe, short_drive)
    assert notes["used"] is False
    assert "99 % on at least 5 asked for" in str(notes["reason"])
    assert kept[0].fitted.record == kept[0].trial
    pd.testing.assert_frame_equal(table, filtered(recipe, short_drive), check_exact=True)


def test_too_short_a_past_leaves_the_filter_as_it_is(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(training={"horizon_s": 150.0, "gap_s": 5.0})
    table, notes, kept = solve(recipe, short_drive)
    assert kept == []
    assert notes["used"] is False
    assert "start the outages later" in str(notes["reason"])
    pd.testing.assert_frame_equal(table, filtered(recipe, short_drive), check_exact=True)


def test_gnss_is_gone_after_the_last_fix_wherever_the_grid_puts_it(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    """A fix 0.03 s before the outage is used at the end of the interval that ends with it."""
    fixes = short_drive.fixes.assign(t=short_drive.fixes["t"] - 0.03)
    known = known_log(replace(short_drive, fixes=fixes), OUTAGE)
    timeline, _, run = FilterRuns(make_recipe()).run(known)
    block, gone = last_fix(run)
    t = timeline.t[run.first :]
    assert float(known.fixes["t"].iloc[-1]) == pytest.approx(419.97)
    assert float(t[gone - 1]) == pytest.approx(420.0)
    assert int(run.history.fix[block]) == int((run.history.fix).max())
    assert bool((run.history.fix[block + 1 :] < 0).all())


def test_runs_are_shared_by_what_is_in_the_log(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    runs = FilterRuns(make_recipe())
    known = known_log(short_drive, OUTAGE)
    first = runs.run(known)
    assert runs.run(known_log(short_drive, OUTAGE)) is first
    assert runs.run(known, filter_options(runs.recipe, "ekf_plain", known)) is not first
    fewer = replace(known, fixes=known.fixes.iloc[:-1])
    assert runs.run(fewer) is not first
    assert runs.run(known_log(short_drive, Outage(420.0, 21.0))) is not first


def test_a_predictor_gets_the_regressors_that_the_run_had(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    """The last emulated outage of the run, and ``predict`` on the log between the same times."""
    recipe = make_recipe()
    runs = FilterRuns(recipe)
    timeline, navigator, run = runs.run(known_log(short_drive, OUTAGE))
    _, gone = last_fix(run)
    begin = float(timeline.t[run.first] - run.samples.dt[0])
    learned = learn(
        recipe, recipe.model("tiny"), navigator, run, end=gone, begin=begin, log_name="short"
    )
    metadata = describe(learned.fitted)
    predictor = LoadedPredictor(module=learned.fitted.model, metadata=metadata, kind="torchscript")
    stop = learned.fitted.record.time_span[1]
    table = predict_drive(predictor, short_drive, start=stop - 15.0, stop=stop)
    found = table[list(metadata.inputs)].to_numpy()
    np.testing.assert_allclose(found, learned.example.numpy(), atol=1e-9)
