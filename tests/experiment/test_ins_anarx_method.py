"""ANARX on a full IMU as methods: what acts, what does not, and what each one says."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import FilterDivergedError
from navlearn.experiment.ins_anarx_data import free_ins
from navlearn.experiment.ins_anarx_method import InsAnarxMethod
from navlearn.experiment.ins_anarx_paper import PaperAnarxMethod, fit_options
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.experiment.jaradat2017_scenario import (
    SCENARIO,
    compare_on_scenario,
    missed_rows,
    scenario_recipe,
    true_positions,
)
from navlearn.experiment.learned import Learned
from navlearn.experiment.methods import build_methods
from navlearn.export import describe
from navlearn.learning.position_fit import fit_position, run_on_own_output
from navlearn.logs.synthetic import jaradat2017_scenario, simulate_drive
from navlearn.mechanization.strapdown_ecef import strapdown_ecef_in_turn, to_ecef
from navlearn.outages.fit_diagnostics import FitDiagnostics, residual_table
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.spec import BUILT_IN

RAW = {"bounds": False, "gate": False}
OUTAGE = Outage(start=330.0, duration=15.0)
RECIPE = {
    "name": "t",
    "question": "?",
    "log": {"simulated": {"profile": "town"}},
    "mechanization": {"sensors": "imu"},
    "methods": ["ins_ekf"],
    "training": {"horizon_s": 15.0, "settle_s": 20.0, "gap_s": 5.0, "minimum_distance": 20.0},
}


def spec(mode, **changes):
    small = {"name": "m", "mode": mode, "hidden": 2, "max_iterations": 4, "starts": 1}
    if mode == "paper":
        small["window_s"] = 90.0
    return InsAnarxSpec.model_validate({**small, **changes})


@pytest.fixture(scope="module")
def runs():
    return InsFilterRuns(Recipe.model_validate(RECIPE))


@pytest.fixture(scope="module")
def known():
    log = simulate_drive(
        profile="town", grade="mems_x", duration=360.0, seed=12, imu_rate_hz=10.0, name="short"
    ).log
    return known_log(log, OUTAGE)


def ekf_table(runs, log):
    line, _, run = runs.run(log)
    t = line.t[run.first :].numpy()
    through = (t > OUTAGE.start + 1.0) & (t <= OUTAGE.end)
    return t[through], run.history.trajectory.lat.numpy()[through]


def test_refused_it_is_the_filter_and_acting_it_is_not(runs, known):
    demanding = {"gate_margin": 0.99}
    refused = InsAnarxMethod(runs, spec("sound", safeguard=demanding)).predict(known, OUTAGE)
    acting = InsAnarxMethod(runs, spec("sound", safeguard=RAW)).predict(known, OUTAGE)
    t, lat = ekf_table(runs, known)
    rows = refused.table["t"].isin(t)
    assert np.array_equal(refused.table.loc[rows, "lat"], lat)
    assert not np.array_equal(acting.table.loc[rows, "lat"], lat)
    assert np.abs(acting.table.loc[rows, "lat"] - lat).max() * 6.37e6 < 50.0
    assert refused.notes["used"] is False
    assert "99 %" in str(refused.notes["reason"])
    assert acting.notes["used"] is True
    assert acting.notes["reason"] != ""
    assert "std_e" in acting.table


def test_models_and_diagnostics_are_handed_on(runs, known):
    kept: dict[str, Learned] = {}
    seen: dict[str, FitDiagnostics] = {}
    for mode in ("sound", "paper"):
        made = spec(mode, name=mode, safeguard=RAW)
        if mode == "sound":
            method = InsAnarxMethod(runs, made, kept.__setitem__, seen.__setitem__)
        else:
            method = PaperAnarxMethod(runs, made, seen.__setitem__)
        method.predict(known, OUTAGE)
    assert set(seen) == {"sound", "paper"}
    table = residual_table(list(seen.values()))
    assert set(table.loc[table["method"] == "sound", "axis"]) == {"along", "cross"}
    assert set(table.loc[table["method"] == "paper", "rows"]) == {
        "all", "at fixes", "between fixes",
    }  # fmt: skip
    assert bool((table.loc[table["rows"] == "all", "count"] > 0).all())
    path = seen["paper"].path
    assert path is not None
    assert path.fix_t.max() < OUTAGE.start
    # What was learned exports like any other model, with the units of its inputs.
    told = describe(kept["sound"].fitted)
    assert told.input_units == ("m/s", "m/s", "m/s")
    assert told.outputs == ("along", "cross")
    assert kept["sound"].example.shape[-1] == 3


def test_paper_learns_from_its_window_and_uses_the_ins(runs, known):
    made = PaperAnarxMethod(runs, spec("paper", safeguard=RAW)).predict(known, OUTAGE)
    assert made.notes["used"] is True
    assert 90.0 < float(str(made.notes["free_ins_s"])) < 90.0 + 15.0 + 2.0
    assert "std_e" not in made.table
    line, navigator, run = runs.run(known)
    free = free_ins(line, navigator, run, since=OUTAGE.start - 90.0)
    # Velocity stays that of the free INS.
    at = np.interp(made.table["t"], free.series.t.numpy(), free.path.v_l[:, 0].numpy())
    assert np.allclose(made.table["v_e"], at, atol=1e-6)


def test_a_gated_paper_model_answers_with_the_filter_where_it_is_worse(runs, known):
    asked = {"gate": True, "gate_margin": 0.05, "gate_fewest": 2}
    made = PaperAnarxMethod(runs, spec("paper", safeguard=asked)).predict(known, OUTAGE)
    t, lat = ekf_table(runs, known)
    assert made.notes["used"] is False
    assert "emulated outages" in str(made.notes["reason"])
    assert np.array_equal(made.table.loc[made.table["t"].isin(t), "lat"], lat)


def test_too_short_a_past_is_told_and_the_filter_answers(runs, known):
    early = Outage(start=85.0, duration=10.0)
    log = known_log(known.with_tables({"fixes": known.fixes}), early)
    for method in (InsAnarxMethod(runs, spec("sound")), PaperAnarxMethod(runs, spec("paper"))):
        made = method.predict(log, early)
        assert made.notes["used"] is False
        assert "start the outages later" in str(made.notes["reason"])


def test_networks_that_run_away_are_reported(runs, known, monkeypatch):
    def away(fits, series, inputs, *, after=0):
        return torch.full((len(series.t) - 1 - after, 3), torch.inf, dtype=torch.float64)

    monkeypatch.setattr("navlearn.experiment.ins_anarx_paper.run_on_own_output", away)
    with pytest.raises(FilterDivergedError, match="ran away"):
        PaperAnarxMethod(runs, spec("paper", safeguard=RAW)).predict(known, OUTAGE)


def test_methods_are_plugged_in():
    names = [name for name, one in BUILT_IN.items() if isinstance(one, InsAnarxSpec)]
    recipe = Recipe.model_validate({**RECIPE, "methods": names})
    made = build_methods(recipe)
    assert {type(method) for method in made.values()} == {InsAnarxMethod, PaperAnarxMethod}
    assert isinstance(made["jaradat2017_safe"], PaperAnarxMethod)


@pytest.fixture(scope="module")
def scenario():
    log = jaradat2017_scenario(11).log
    line, navigator, run = InsFilterRuns(scenario_recipe()).run(log)
    return log, run, free_ins(line, navigator, run)


def test_free_ins_is_the_papers_earth_fixed_strapdown(scenario):
    _, run, free = scenario
    belief_start = to_ecef(run.alignment.state)
    steps = 1000
    samples = type(run.samples)(*(channel[:steps] for channel in run.samples))
    ecef = strapdown_ecef_in_turn(belief_start, samples)
    mine = free.series.ins[: steps - free.first]
    assert float((ecef.position[free.first :] - mine).norm(dim=-1).max()) < 1e-3


def test_targets_are_fixes_less_ins_to_the_noise_of_fixes(scenario):
    log, _, free = scenario
    truth = true_positions(log, free.series.t)
    error = (free.series.target - (truth - free.series.ins))[free.series.at_fix].numpy()
    assert np.allclose(error.std(0), 2.0, atol=0.2)
    assert np.abs(error.mean(0)).max() < 0.3
    missed = missed_rows(free)
    assert len(missed) == 4
    assert int(free.series.delay.max()) in (19, 29, 39, 49)
    t = free.series.t.numpy()
    due = np.setdiff1d(np.arange(0.0, 100.01, 0.2).round(1), log.fixes["t"].round(1))
    assert np.allclose(np.sort(t[missed]), due, atol=1e-6)


def test_a_tiny_mean_residual_says_nothing_of_use(scenario):
    # Even handed the truth for a target, which nothing else in this package may see.
    log, _, free = scenario
    truth = true_positions(log, free.series.t)
    told = free.series._replace(target=truth - free.series.ins)
    one = BUILT_IN["jaradat2017"]
    fits = fit_position(told, fit_options(one, scenario_recipe(), told))
    residual = (fits[0].predicted - fits[0].windows.windows.y.squeeze(-1))[
        fits[0].windows.part == 0
    ]
    used = told.ins[1:] + run_on_own_output(fits, told, one.inputs) - truth[1:]
    assert abs(float(residual.mean())) < 1e-4
    assert float(residual.square().mean().sqrt()) < 0.05
    assert float(used[:, 0].square().mean().sqrt()) > 5.0


def test_training_never_reads_the_truth(scenario):
    log, _, _ = scenario
    brief = [spec("paper", name="open"), spec("sound", name="sound")]
    recipe = scenario_recipe()
    table = compare_on_scenario(11, brief, recipe)
    runs = InsFilterRuns(recipe)
    blind = runs.run(replace(log, reference=None))
    series = free_ins(*blind).series
    fits = fit_position(series, fit_options(brief[0], recipe, series))
    residual = fits[0].predicted - fits[0].windows.windows.y.squeeze(-1)
    mine = float(residual[fits[0].windows.part == 0].square().mean().sqrt())
    row = table[(table["method"] == "open") & (table["measure"] == "training residual")]
    assert row["rms"].iloc[0] == pytest.approx(mine, rel=1e-12)
    used = table[table["measure"] == "in use"].set_index(["method", "axis"])["rms"]
    # The filter beats the last fix, which beats the free INS.
    for axis in "xyz":
        assert used["ins_ekf", axis] < used["last fix", axis] < used["ins", axis]
    assert set(table["method"]) == {"open", "sound", "ins", "last fix", "ins_ekf"}
    assert isinstance(table, pd.DataFrame)
    assert SCENARIO["training"]["step_s"] == recipe.training.step_s
