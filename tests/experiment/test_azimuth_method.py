"""The papers' methods on a drive: causal, refused like the filter, steered by what they learned."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import ConfigError, FitError
from navlearn.experiment.anarx_method import last_fix
from navlearn.experiment.azimuth_filter import Beside, steer
from navlearn.experiment.azimuth_method import AzimuthMethod
from navlearn.experiment.azimuth_model import fit_azimuth
from navlearn.experiment.baselines import FilterMethod, FilterRuns
from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.feed_forward import FeedForward, block_before
from navlearn.experiment.learned import Learned
from navlearn.experiment.methods import build_methods
from navlearn.export import describe
from navlearn.frames import enu_between
from navlearn.learning.azimuth_windows import azimuth_rows, predicted_errors
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import belief_at
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import check_solution
from navlearn.outages.replay import BatchMethod, Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.recipe.spec import BUILT_IN
from navlearn.recipe.spec_base import SafeguardSpec
from navlearn.states import Trajectory

MakeRecipe = Callable[..., Recipe]
OUTAGE = Outage(420.0, 20.0)
NAMES = ("iqbal2020", "iqbal2020_safe", "shen2010", "shen2010_safe")
RAW = SafeguardSpec(bounds=False, gate=False)


@pytest.fixture(scope="module")
def runs(make_recipe: MakeRecipe) -> FilterRuns:
    return FilterRuns(make_recipe(methods=("ekf",)))


@pytest.fixture(scope="module")
def known(short_drive: DriveLog) -> DriveLog:
    return known_log(short_drive, OUTAGE)


def solve(runs: FilterRuns, known: DriveLog, spec: AzimuthSpec) -> Solution:
    found = AzimuthMethod(runs, spec).predict(known, OUTAGE)
    check_solution(found.table, OUTAGE)
    return found


def filtered(runs: FilterRuns, known: DriveLog) -> pd.DataFrame:
    return FilterMethod(runs, "ekf").predict(known, OUTAGE).table


def beside(runs: FilterRuns, known: DriveLog, spec: AzimuthSpec) -> tuple[Beside, int]:
    timeline, _, run = runs.run(known)
    return Beside(runs, spec, known, timeline, run), last_fix(run)[1]


def one_run(runs: FilterRuns, known: DriveLog, spec: AzimuthSpec) -> tuple[Beside, FeedForward]:
    filter, gone = beside(runs, known, spec)
    return filter, filter.run([(gone - 600, gone, gone + 200)])[0]


@pytest.mark.parametrize("name", NAMES)
def test_every_built_in_solves_and_tells_its_verdict(
    runs: FilterRuns, known: DriveLog, name: str
) -> None:
    spec = BUILT_IN[name]
    assert isinstance(spec, AzimuthSpec)
    found = solve(runs, known, spec)
    safe = name.endswith("_safe")
    assert found.notes["used"] is True or safe
    assert "emulated outages" in str(found.notes["reason"]) if safe else True
    for note in ("training_explained_percent", "inputs_outside_training", "training_rows"):
        assert np.isfinite(float(str(found.notes[note])))
    assert 0 <= int(str(found.notes["terms" if "shen" in name else "cascades"])) <= 8
    plain = filtered(runs, known)
    assert list(found.table.columns) == list(plain.columns)
    if found.notes["used"]:
        moved = (found.table["lat"] - plain["lat"]).abs() * 6.37e6
        assert moved.iloc[0] < 3.0  # both go on from the last fix
        assert moved.max() > 1e-3


def test_what_is_kept_can_be_exported_and_tells_when_it_learned(
    runs: FilterRuns, known: DriveLog
) -> None:
    kept: list[Learned] = []
    for structure in ("fos", "pci"):
        spec = AzimuthSpec(
            name="a", structure=structure, window_s=60.0, target="rate", safeguard=RAW
        )
        AzimuthMethod(runs, spec, lambda _, one: kept.append(one)).predict(known, OUTAGE)
    for learned in kept:
        told = describe(learned.fitted)
        assert told.input_units[told.inputs.index("azimuth")] == "rad"
        assert told.output_units == ("rad per step",)
        begin, end = learned.fitted.record.time_span
        assert OUTAGE.start - 1.5 < end <= OUTAGE.start
        assert 57.0 < end - begin < 61.0
        assert learned.example.shape == (22, len(told.inputs))


def test_refused_is_exactly_the_filter(runs: FilterRuns, known: DriveLog) -> None:
    guard = SafeguardSpec(gate_margin=0.99)
    for structure in ("fos", "pci"):
        found = solve(runs, known, AzimuthSpec(name="a", structure=structure, safeguard=guard))
        assert found.notes["used"] is False
        assert "99 % on at least 5 asked for" in str(found.notes["reason"])
        pd.testing.assert_frame_equal(found.table, filtered(runs, known), check_exact=True)


def test_a_past_shorter_than_the_window_is_the_filter(runs: FilterRuns, known: DriveLog) -> None:
    found = solve(runs, known, AzimuthSpec(name="a", structure="fos", window_s=900.0))
    assert found.notes["used"] is False
    assert "shorten window_s" in str(found.notes["reason"])
    pd.testing.assert_frame_equal(found.table, filtered(runs, known), check_exact=True)


def test_a_model_learned_from_noise_is_refused(make_recipe: MakeRecipe, known: DriveLog) -> None:
    """The course that both learn from is noise of some degrees here; the filter knows as much."""
    rng = np.random.default_rng(5)
    fixes = known.fixes.copy()
    for column in ("v_e", "v_n"):
        fixes[column] += rng.normal(0.0, 0.7, len(fixes))
    fixes["std_v"] = 0.7
    noisy, runs = replace(known, fixes=fixes), FilterRuns(make_recipe(methods=("ekf",)))
    raw = AzimuthSpec(name="a", structure="fos", acceptance="none", safeguard=RAW)
    learned = solve(runs, noisy, raw).notes
    assert learned["terms"] == 8
    assert float(str(learned["training_explained_percent"])) > 40.0
    safe = solve(runs, noisy, AzimuthSpec(name="a", structure="fos", acceptance="none"))
    assert safe.notes["used"] is False
    pd.testing.assert_frame_equal(safe.table, filtered(runs, noisy), check_exact=True)


@pytest.mark.parametrize("filter", ["recipe", "bias_free", "shen2010", "shen2010_full"])
def test_rows_tell_the_free_mechanization(runs: FilterRuns, known: DriveLog, filter: str) -> None:
    """A_mec against the mechanization run alone from where the window begins."""
    spec = AzimuthSpec(name="a", structure="fos", filter=filter, safeguard=RAW)
    source, run = one_run(runs, known, spec)
    rows = azimuth_rows(
        source.ekf.model, run.history, run.samples, run.fixes, run.timing,
        step=1.0, slowest=5.0, origin=run.gone - 1,
    )  # fmt: skip
    ends = run.history.end
    start = belief_at(source.closed.history, block_before(source.closed.history, run.begin))
    clock = torch.cumsum(run.samples.dt, -1)
    bias = start.sensor[1 if "shen" in filter else 0] if filter != "bias_free" else 0.0
    moving = run.samples.dt * (1.0 - run.samples.stationary)
    turn = torch.cumsum((bias - run.samples.yaw_rate) * moving, -1)
    # Earth and transport rate are left out of this: 15 °/h for 80 s.
    found = rows.azimuth - start.state.azimuth
    at = torch.searchsorted(clock, rows.time - 1e-9)
    assert float((found - turn[at]).abs().max()) < 1e-2
    assert torch.equal(clock[at], rows.time)
    assert set(at.tolist()) <= set(ends.tolist())
    # A course each second while fixes last and the car is fast, and none later.
    assert float(rows.has_course[rows.time > clock[run.gone - 1] + 0.5].sum()) == 0.0
    fast = (run.samples.speed[at] > 5.5) & (rows.time <= clock[run.gone - 1] + 1e-9)
    assert float(rows.has_course[fast].mean()) > 0.9
    residual = (rows.azimuth - rows.predicted - rows.course)[rows.has_course > 0.0]
    assert float(torch.atan2(residual.sin(), residual.cos()).abs().median()) < 0.05


def test_a_filter_that_feeds_back_has_no_predictions(runs: FilterRuns, known: DriveLog) -> None:
    _, navigator, run = runs.run(known)
    with pytest.raises(ConfigError, match="feedback='open'"):
        predicted_errors(navigator.filter.model, run.history, run.samples)


def test_runs_at_once_equal_runs_one_by_one(runs: FilterRuns, known: DriveLog) -> None:
    spec = AzimuthSpec(name="a", structure="fos")
    source, gone = beside(runs, known, spec)
    spans = [(gone - 600, gone, gone + 100), (gone - 1507, gone - 903, gone - 700)]
    both = source.run(spans)
    for span, together in zip(spans, both, strict=True):
        alone = source.run([span])[0]
        assert (together.begin, together.gone) == (alone.begin, alone.gone)
        torch.testing.assert_close(together.history.end, alone.history.end)
        torch.testing.assert_close(together.history.fix, alone.history.fix)
        for a, b in zip(together.history.trajectory, alone.history.trajectory, strict=True):
            # The last block of the shorter one is closed after intervals that pad it.
            torch.testing.assert_close(a[:-1], b[:-1], atol=1e-12, rtol=1e-12)
            torch.testing.assert_close(a, b, atol=1e-6, rtol=0)
        torch.testing.assert_close(together.history.error, alone.history.error)
        assert bool((together.history.fix[together.history.end >= together.gone] < 0).all())


def apart(path: Trajectory, other: Trajectory) -> float:
    east, north, _ = enu_between(
        path.lat, path.lon, path.height, other.lat, other.lon, other.height
    )
    return float(torch.hypot(east, north).max())


def test_without_a_correction_the_steered_car_drives_as_the_filter(
    runs: FilterRuns, known: DriveLog
) -> None:
    spec = AzimuthSpec(name="a", structure="fos", safeguard=RAW)
    source, run = one_run(runs, known, spec)
    learned = fit_azimuth(spec, source.ekf.model, run, step=1.0)
    silent = replace(learned, residual=torch.zeros_like(learned.residual))
    path = steer(source.options, run, silent)
    through = Trajectory(*(channel[run.gone :] for channel in run.history.trajectory))
    assert apart(path, through) < 0.05
    # And the open filter goes through the outage as the closed one does.
    closed = Trajectory(
        *(c[run.begin + run.gone :][:200] for c in source.closed.history.trajectory)
    )
    assert apart(path, closed) < 1.0
    # A residual of 0.1 rad turns the whole way by that, to the left.
    turned = replace(learned, residual=torch.full_like(learned.residual, 0.1))
    way = float((run.samples.speed * run.samples.dt)[run.gone :].sum())
    assert 0.0 < apart(steer(source.options, run, turned), path) <= 0.1 * way * 1.05
    assert float(steer(source.options, run, turned).azimuth[3]) == pytest.approx(
        float(path.azimuth[3]) - 0.1
    )


def poisoned(log: DriveLog, since: float) -> DriveLog:
    fixes = log.fixes.copy()
    rows = fixes["t"] >= since
    for name, value in {
        "lat": -0.3,
        "lon": 2.0,
        "v_e": 340.0,
        "v_n": -340.0,
        "std_e": 0.01,
    }.items():
        fixes.loc[rows, name] = value
    return replace(log, fixes=fixes)


def test_nothing_in_or_after_the_outage_is_used(
    make_recipe: MakeRecipe, short_drive: DriveLog
) -> None:
    recipe = make_recipe(methods=("ekf", *NAMES))
    log = prepare_drive(recipe).log
    clean = build_methods(recipe)
    spoilt = build_methods(recipe)
    for name in NAMES:
        one = clean[name].predict(known_log(log, OUTAGE), OUTAGE)
        other = spoilt[name].predict(known_log(poisoned(log, OUTAGE.start), OUTAGE), OUTAGE)
        pd.testing.assert_frame_equal(one.table, other.table, check_exact=True)
        assert one.notes == other.notes
    earlier = poisoned(log, OUTAGE.start - 3.0)
    moved = build_methods(recipe)["shen2010"].predict(known_log(earlier, OUTAGE), OUTAGE)
    first = clean["shen2010"].predict(known_log(log, OUTAGE), OUTAGE)
    assert not moved.table["lat"].equals(first.table["lat"])


def test_several_outages_at_once_equal_one_by_one(runs: FilterRuns, short_drive: DriveLog) -> None:
    outages = [OUTAGE, Outage(400.5, 25.0)]
    logs = [known_log(short_drive, one) for one in outages]
    for name in ("shen2010_safe", "iqbal2020"):
        spec = BUILT_IN[name]
        assert isinstance(spec, AzimuthSpec)
        method = AzimuthMethod(runs, spec)
        assert isinstance(method, BatchMethod)
        together = method.predict_many(logs, outages)
        for one, known, outage in zip(together, logs, outages, strict=True):
            alone = method.predict(known, outage)
            assert one.notes["used"] == alone.notes["used"]
            # The last block of a shorter window is closed after intervals that pad it.
            figures = list(alone.table.columns.drop("t"))
            np.testing.assert_array_equal(one.table["t"], alone.table["t"])
            np.testing.assert_allclose(one.table[figures], alone.table[figures], atol=1e-5)


def test_spans_before_the_filter_began_are_refused(runs: FilterRuns, known: DriveLog) -> None:
    source, gone = beside(runs, known, AzimuthSpec(name="a", structure="fos"))
    with pytest.raises(FitError, match="start the outages later"):
        source.run([(0, gone, gone + 10)])
