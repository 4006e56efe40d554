"""Worst fixes of a drive whose faults are known, through gates that believe all or refuse them."""

import numpy as np
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.experiment.drive import open_log, timeline_of
from navlearn.experiment.gated_run import gated_run
from navlearn.experiment.integrity_ways import WAYS
from navlearn.experiment.worst_fixes import drive_figures, gated_runs, through_worst, worst_fixes
from navlearn.fusion.gate_options import GateOptions
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.recipe import Recipe

RECIPE = Recipe.model_validate(
    {
        "name": "spiked",
        "log": {
            "simulated": {"duration_s": 500, "imu_rate_hz": 10, "seed": 13},
            "faults": {
                "spikes": {"sizes_m": [60], "per_hour": 120},
                "apart_s": 25,
                "settle_s": 150,
            },
        },
        "mechanization": {"dims": 2},
    }
)
PATIENT = {"no test": WAYS["no test"], "limit": GateOptions(probability=1.0, prediction_limit=30.0)}


@pytest.fixture(scope="module")
def judged():
    log = open_log(RECIPE)
    faults = injected_faults(log)
    worst = worst_fixes(log, len(faults))
    return log, faults, worst, gated_runs(log, RECIPE, PATIENT)


def test_the_worst_fixes_are_those_that_were_spoilt(judged):
    _, faults, worst, _ = judged
    assert len(faults) > 3
    np.testing.assert_allclose(worst["t"], faults["t"])
    np.testing.assert_allclose(worst["fix_error"], 60.0, atol=8.0)
    assert (worst["stated"] < 3.0).all()


def test_what_is_believed_moves_the_filter_and_what_is_refused_does_not(judged):
    _, _, worst, runs = judged
    found = through_worst(worst, runs)
    believed, refused = (found[found["way"] == way] for way in PATIENT)
    assert not believed["caught"].any()
    assert refused["caught"].all()
    assert (believed["error"].to_numpy() > 2.0 * refused["error"].to_numpy()).all()
    assert refused["largest"].max() < 5.0
    assert (found["largest"] >= found["error"] - 1e-6).all()
    figures = drive_figures(worst, runs).set_index("way")
    assert figures["worst caught"].tolist() == [f"0/{len(worst)}", f"{len(worst)}/{len(worst)}"]
    assert figures.loc["no test", "near RMS"] > 2.0 * figures.loc["limit", "near RMS"]
    assert figures.loc["no test", "near largest"] == found["largest"].max()
    assert figures.loc["limit", "caught in all"] == len(worst)


def test_errors_are_those_of_the_reference(judged):
    log, _, _, runs = judged
    errors = runs["limit"].errors
    assert set(errors["t"]) <= set(log.reference["t"])
    assert 0.2 < np.sqrt((errors["horizontal"] ** 2).mean()) < 3.0
    fixes = runs["limit"].fixes
    assert set(fixes["t"].round(6)) <= set(log.fixes["t"].round(6))


def test_what_cannot_be_judged_is_said(judged):
    log = judged[0]
    with pytest.raises(ConfigError, match="worst fixes asked for"):
        worst_fixes(log, 500)
    late = worst_fixes(log, 1, since=300.0)
    assert late["t"].iloc[0] >= 300.0
    bare = log.with_tables({})
    object.__setattr__(bare, "reference", None)
    with pytest.raises(LogError, match="has no reference"):
        gated_run(bare, timeline_of(log, RECIPE), WAYS["no test"])
