"""Corrected gyros as methods: used where they help, the filter's own answer where they do not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import torch

from navlearn.error_models.storage import load_error_model, save_error_model
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.baselines import FilterMethod, FilterRuns
from navlearn.experiment.corrected_filter import Stretch, filter_stretches
from navlearn.experiment.gyro_gate import past_origins
from navlearn.experiment.learned import Learned
from navlearn.experiment.methods import build_methods
from navlearn.experiment.pseudo_outage_method import PseudoOutageMethod
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.native import save_log
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import check_solution, errors_over_time
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe, recipe_for
from navlearn.recipe.pseudo_outage_spec import PseudoOutageSpec
from navlearn.recipe.spec import BUILT_IN
from navlearn.recipe.spec_base import SafeguardSpec

OUTAGE = Outage(740.0, 60.0)
RAW = SafeguardSpec(bounds=False, gate=False)
MakeRuns = Callable[[DriveLog], FilterRuns]


def simulated(grade: str) -> DriveLog:
    return simulate_drive(
        profile="mixed", grade=grade, duration=810.0, seed=12, imu_rate_hz=10.0, name=grade
    ).log


@pytest.fixture(scope="module")
def bad_gyro() -> DriveLog:
    return simulated("mems_x")


@pytest.fixture(scope="module")
def make_runs(tmp_path_factory: pytest.TempPathFactory) -> MakeRuns:
    made: dict[str, FilterRuns] = {}

    def make(log: DriveLog) -> FilterRuns:
        name = log.metadata.name
        if name not in made:
            folder: Path = tmp_path_factory.mktemp("drives") / name
            save_log(log, folder)
            recipe: Recipe = recipe_for(folder, methods=("ekf", "pseudo_outage"))
            made[name] = FilterRuns(recipe)
        return made[name]

    return make


def solve(runs: FilterRuns, log: DriveLog, **changed: object) -> Solution:
    spec = PseudoOutageSpec.model_validate({"name": "one", **changed})
    found = PseudoOutageMethod(runs, spec).predict(known_log(log, OUTAGE), OUTAGE)
    check_solution(found.table, OUTAGE)
    return found


def filtered(runs: FilterRuns, log: DriveLog) -> Solution:
    return FilterMethod(runs, "ekf").predict(known_log(log, OUTAGE), OUTAGE)


def largest_error(solution: Solution, log: DriveLog) -> float:
    errors = errors_over_time(solution.table, track_of(log), OUTAGE)
    return float(errors["horizontal"].max())


@pytest.mark.parametrize("structure", ["ridge", "fos"])
def test_a_badly_calibrated_gyro_is_corrected(
    bad_gyro: DriveLog, make_runs: MakeRuns, structure: str
) -> None:
    runs = make_runs(bad_gyro)
    found = solve(runs, bad_gyro, structure=structure)
    notes = found.notes
    assert notes["used"] is True
    assert notes["gate_replays"] >= 5  # type: ignore[operator]
    assert notes["gate_improvement_percent"] > 30.0  # type: ignore[operator]
    assert notes["coefficients"]
    assert "emulated outages" in str(notes["reason"])
    assert largest_error(found, bad_gyro) < 0.6 * largest_error(filtered(runs, bad_gyro), bad_gyro)


def test_both_restarts_correct(bad_gyro: DriveLog, make_runs: MakeRuns) -> None:
    runs = make_runs(bad_gyro)
    plain = largest_error(filtered(runs, bad_gyro), bad_gyro)
    for restart in ("filter", "regression"):
        found = solve(runs, bad_gyro, restart=restart)
        assert largest_error(found, bad_gyro) < 0.6 * plain
        assert bool((found.table["std_e"] > 0.0).all())


@pytest.mark.parametrize("structure", ["ridge", "fos", "pci"])
def test_refused_is_exactly_the_filter(
    bad_gyro: DriveLog, make_runs: MakeRuns, structure: str
) -> None:
    runs = make_runs(bad_gyro)
    found = solve(runs, bad_gyro, structure=structure, safeguard={"gate_margin": 0.99})
    assert found.notes["used"] is False
    expected = filtered(runs, bad_gyro).table
    pd.testing.assert_frame_equal(found.table, expected, check_exact=True)


def test_the_gate_keeps_harm_out_where_there_is_nothing_to_correct(make_runs: MakeRuns) -> None:
    """Terms that explain noise are harmful; asked for twenty of them, FOS finds them."""
    log = simulated("tactical")
    runs = make_runs(log)
    noise = {
        "structure": "fos",
        "max_terms": 20,
        "false_alarm": 1.0,
        "other_prior_deg_per_s": 5.0,
        "fix_variance": 0.02,
    }
    found = solve(runs, log, **noise)
    assert found.notes["used"] is False
    assert found.notes["gate_improvement_percent"] < 0.0  # type: ignore[operator]
    plain = filtered(runs, log)
    pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)
    raw = solve(runs, log, **noise, safeguard=RAW.model_dump())
    assert largest_error(raw, log) > largest_error(plain, log)


def test_too_little_past_is_refused_with_a_reason(bad_gyro: DriveLog, make_runs: MakeRuns) -> None:
    early = Outage(60.0, 20.0)
    known = known_log(bad_gyro, early)
    spec = PseudoOutageSpec(name="early")
    found = PseudoOutageMethod(make_runs(bad_gyro), spec).predict(known, early)
    assert found.notes["used"] is False
    assert found.notes["reason"]


def test_raw_is_used_unasked(bad_gyro: DriveLog, make_runs: MakeRuns) -> None:
    found = solve(make_runs(bad_gyro), bad_gyro, safeguard=RAW.model_dump())
    assert found.notes["used"] is True
    assert "switches the gate off" in str(found.notes["reason"])


@pytest.mark.parametrize("structure", ["ridge", "fos", "pci"])
def test_nothing_after_the_outage_begins_is_seen(
    bad_gyro: DriveLog, make_runs: MakeRuns, structure: str
) -> None:
    runs = make_runs(bad_gyro)
    clean = solve(runs, bad_gyro, structure=structure)
    fixes, reference = bad_gyro.fixes.copy(), bad_gyro.reference
    assert reference is not None
    late = fixes["t"] >= OUTAGE.start
    fixes.loc[late, ["lat", "v_e"]] = [-0.3, 340.0]
    reference = reference.copy()
    reference.loc[reference["t"] >= OUTAGE.start, "azimuth"] = 3.0
    spoilt = solve(runs, replace(bad_gyro, fixes=fixes, reference=reference), structure=structure)
    pd.testing.assert_frame_equal(clean.table, spoilt.table, check_exact=True)
    assert clean.notes == spoilt.notes


def test_models_are_kept_and_come_back_from_disk(
    bad_gyro: DriveLog, make_runs: MakeRuns, tmp_path: Path
) -> None:
    kept: dict[str, Learned] = {}
    method = PseudoOutageMethod(
        make_runs(bad_gyro), PseudoOutageSpec(name="kept", structure="pci"), kept.__setitem__
    )
    method.predict(known_log(bad_gyro, OUTAGE), OUTAGE)
    learned = kept["kept"]
    assert learned.fitted.record.source.acts_on == "gyro_rate"
    save_error_model(learned.fitted, tmp_path / "kept.pt")
    again = load_error_model(tmp_path / "kept.pt")
    with torch.no_grad():
        assert torch.equal(again.model(learned.example), learned.fitted.model(learned.example))


def test_stretches_side_by_side_equal_the_run_itself(
    bad_gyro: DriveLog, make_runs: MakeRuns
) -> None:
    """With nothing taken off the gyro a stretch is the run again, whatever stands beside it."""
    timeline, navigator, run = make_runs(bad_gyro).run(known_log(bad_gyro, OUTAGE))
    block, gone = last_fix(run)
    stretches = [Stretch(block - 200, gone, gone + 50), Stretch(block - 60, gone, gone + 50)]
    found = filter_stretches(navigator, run, timeline.fixes, timeline.timing, stretches)
    for k, one in enumerate(stretches):
        begin = int(run.history.end[one.block]) + 1
        expected = run.history.trajectory.lat[begin : gone + 50]
        mine = found.trajectory.lat[k, : gone + 50 - begin]
        assert float((mine - expected).abs().max()) * 6.4e6 < 0.05


def test_origins_are_spaced_and_end_before_the_outage(
    bad_gyro: DriveLog, make_runs: MakeRuns
) -> None:
    _, _, run = make_runs(bad_gyro).run(known_log(bad_gyro, OUTAGE))
    _, gone = last_fix(run)
    blocks = past_origins(run, gone=gone, length=600, every=300, after=2400, least_distance=60.0)
    starts = run.history.end[torch.tensor(blocks)]
    assert len(blocks) >= 5
    assert bool((torch.diff(starts) >= 300).all())
    assert int(starts[-1]) + 600 < gone
    assert int(starts[0]) >= 2400


def test_built_in_names_are_this_method(bad_gyro: DriveLog, make_runs: MakeRuns) -> None:
    names = ("pseudo_outage", "ekf+fos", "ekf+pci")
    recipe = make_runs(bad_gyro).recipe
    specs = tuple(BUILT_IN[name] for name in names)
    methods = build_methods(recipe.model_copy(update={"methods": names, "models": specs}))
    for name, structure in zip(names, ("ridge", "fos", "pci"), strict=True):
        assert isinstance(methods[name], PseudoOutageMethod)
        assert BUILT_IN[name].structure == structure  # type: ignore[attr-defined]
        assert structure in BUILT_IN[name].describe().lower() or structure == "ridge"


def test_specs_refuse_unknown_terms() -> None:
    for bad in ({"terms": ["wheel"]}, {"factors": ["yaw_rate*f_x"]}, {"terms": []}):
        with pytest.raises(ValueError, match=r"wheel|product|at least 1"):
            PseudoOutageSpec.model_validate({"name": "bad", **bad})


def test_no_term_found_is_the_filter_as_it_is(make_runs: MakeRuns) -> None:
    log = simulated("tactical")
    runs = make_runs(log)
    found = solve(runs, log, structure="fos", false_alarm=1e-9, safeguard=RAW.model_dump())
    assert found.notes["used"] is False
    assert "none was found" in str(found.notes["reason"])
    pd.testing.assert_frame_equal(found.table, filtered(runs, log).table, check_exact=True)
