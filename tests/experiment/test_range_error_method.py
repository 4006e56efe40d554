"""Range-error models on drives: what is known of them, what they may see, and when they act."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.experiment.learned import Learned
from navlearn.experiment.range_error_gate import judged, past_of, replayed
from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.range_error_replays import (
    one_of,
    recent_replays,
    rms_error,
    run_replays,
)
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.experiment.tight_method import TightMethod
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import PRESETS
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import errors_over_time
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.recipe import Recipe
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.tight_navigator import tight_belief_at

START, DURATION = 520.0, 30.0
QUICK: dict[str, Any] = {
    "window_s": 400.0,
    "gate_horizon_s": 30.0,
    "gate_every_s": 30.0,
    "gate_replays": 8,
}


def driven(**sky: Any) -> DriveLog:
    """A drive whose ranges err as told and in nothing else."""
    return simulate_drive(
        profile="town",
        grade="tactical",
        duration=START + DURATION + 20.0,
        seed=7,
        imu_rate_hz=10.0,
        name="short",
        satellites=replace(PRESETS["ideal"], **sky),
    ).log


def spec(structure: str = "pci", **content: Any) -> RangeErrorSpec:
    told = {"name": "model", "structure": structure, **QUICK, **content}
    return RangeErrorSpec.model_validate(told)


def fresh_runs() -> TightFilterRuns:
    simulated = {"profile": "town", "grade": "tactical", "duration_s": 600.0, "seed": 7}
    return TightFilterRuns(
        Recipe.model_validate({"name": "a", "log": {"simulated": simulated}, "methods": ["tc_ekf"]})
    )


def highest(log: DriveLog, count: int) -> Outage:
    """An outage through which the satellites of the strongest signal stay."""
    assert log.ranges is not None
    through = log.ranges[log.ranges["t"].between(START - 250.0, START + DURATION)]
    found = through.groupby("satellite")["cn0"].agg(["size", "mean"])
    always = found[found["size"] == found["size"].max()].sort_values("mean", ascending=False)
    return Outage(START, DURATION, tuple(str(name) for name in always.index[:count]))


@pytest.fixture(scope="module")
def systematic() -> DriveLog:
    return driven(thermal=0.3, systematic=6.0, fading=2.0)


@pytest.fixture(scope="module")
def runs() -> TightFilterRuns:
    return fresh_runs()


def rms(solution: Solution, log: DriveLog, outage: Outage) -> float:
    error = errors_over_time(solution.table, track_of(log), outage)["horizontal"].to_numpy()
    return float(np.sqrt(np.mean(error**2)))


def test_without_satellites_it_is_the_filter_to_the_last_digit(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = Outage(START, DURATION)
    known = known_log(systematic, outage)
    plain = TightMethod(runs).predict(known, outage)
    found = RangeErrorMethod(runs, spec(safeguard={"gate": False})).predict(known, outage)
    pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)
    assert found.notes["used"] is False
    assert "no satellite stays" in str(found.notes["reason"])


def test_where_enough_satellites_stay_there_is_nothing_to_do(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 5)
    known = known_log(systematic, outage)
    plain = TightMethod(runs).predict(known, outage)
    found = RangeErrorMethod(runs, spec(safeguard={"gate": False})).predict(known, outage)
    pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)
    assert "5 satellites stay" in str(found.notes["reason"])


def test_an_error_that_follows_from_elevation_and_cn0_is_learned_and_helps(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 3)
    known = known_log(systematic, outage)
    kept: dict[str, Learned] = {}
    model = spec(inputs=("elevation", "cn0"), lags=5)
    found = RangeErrorMethod(runs, model, kept.__setitem__).predict(known, outage)
    assert found.notes["used"] is True, found.notes
    assert found.notes["satellites_corrected"] == " ".join(sorted(outage.satellites_visible))
    assert set(kept) == {f"model_{name}" for name in outage.satellites_visible}
    plain = TightMethod(runs).predict(known, outage)
    assert rms(found, systematic, outage) < 0.8 * rms(plain, systematic, outage)


@pytest.mark.parametrize("structure", ["fos", "anarx", "held", "decay"])
def test_every_structure_corrects_the_satellites_that_stay_alone(
    systematic: DriveLog, runs: TightFilterRuns, structure: str
) -> None:
    outage = highest(systematic, 2)
    known = known_log(systematic, outage)
    found = RangeErrorMethod(runs, spec(structure, safeguard={"gate": False})).predict(
        known, outage
    )
    plain = TightMethod(runs).predict(known, outage)
    assert found.notes["used"] is True
    assert str(found.notes["satellites_corrected"]).split() == sorted(outage.satellites_visible)
    assert float(found.notes["largest_correction_m"]) > 0.0  # type: ignore[arg-type]
    assert not found.table["lat"].equals(plain.table["lat"])


def test_wider_ranges_are_those_of_a_receiver_that_tells_so(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 2)
    known = known_log(systematic, outage)
    model = spec("none", wider_m=4.0, safeguard={"gate": False})
    found = RangeErrorMethod(runs, model).predict(known, outage)
    assert known.ranges is not None
    later = known.ranges["t"] >= outage.start
    told = np.hypot(known.ranges["std_range"], 4.0)
    wider = replace(
        known, ranges=known.ranges.assign(std_range=known.ranges["std_range"].where(~later, told))
    )
    expected = TightMethod(fresh_runs()).predict(wider, outage).table
    columns = ["lat", "lon", "std_e", "std_n"]
    np.testing.assert_allclose(found.table[columns], expected[columns], rtol=1e-12)
    assert found.notes["largest_correction_m"] == 0.0
    plain = TightMethod(runs).predict(known, outage).table
    assert (found.table["std_e"].iloc[-1] > plain["std_e"].iloc[-1]) | (
        found.table["std_n"].iloc[-1] > plain["std_n"].iloc[-1]
    )


def test_white_errors_are_refused() -> None:
    """What is white tells nothing of what comes, whatever a model makes of its window."""
    log, runs = driven(thermal=3.0), fresh_runs()
    outage = highest(log, 3)
    known = known_log(log, outage)
    plain = TightMethod(runs).predict(known, outage)
    for structure in ("pci", "held", "decay"):
        found = RangeErrorMethod(runs, spec(structure)).predict(known, outage)
        assert found.notes["used"] is False
        assert float(found.notes["gate_improvement_percent"]) < 5.0  # type: ignore[arg-type]
        pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)


def test_emulated_outages_are_the_filter_run_on(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    """With every satellite left, nothing is lost; with some, a batch equals one by one."""
    outage = highest(systematic, 2)
    start = runs.before(known_log(systematic, outage), outage)
    past, model = past_of(start), spec()
    names = start.series.satellites
    visible = torch.tensor([name in outage.satellites_visible for name in names])
    absent = visible.clone()
    absent[int((past.heard.ranges.has_range > 0.5).sum(0).argmin())] = True
    never = past.heard._replace(
        ranges=past.heard.ranges._replace(
            has_range=torch.where(absent, 0.0, past.heard.ranges.has_range)
        )
    )
    assert recent_replays(start.run, never, absent, model) is None
    replays = recent_replays(start.run, past.heard, visible, model)
    assert replays is not None
    whole = replays.ranges._replace(
        has_range=past.heard.ranges.has_range[replays.reception.clamp(min=0)],
        has_rate=past.heard.ranges.has_rate[replays.reception.clamp(min=0)],
    )
    again = run_replays(start.navigator, start.run, replays, whole)
    assert float(rms_error(again.trajectory, replays.reference).max()) < 1e-6
    starts = start.run.history.end[replays.block]
    assert bool((torch.diff(starts) >= 300).all())
    assert int(starts[-1]) + 300 < len(start.run.samples.dt)
    some = run_replays(start.navigator, start.run, replays, replays.ranges)
    assert float(rms_error(some.trajectory, replays.reference).min()) > 1e-3
    alone = start.navigator.filter_on(
        tight_belief_at(start.run.history, int(replays.block[1])),
        one_of(replays.samples, 1),
        one_of(replays.ranges, 1),
        one_of(replays.timing, 1),
    )
    torch.testing.assert_close(alone.trajectory.lat, some.trajectory.lat[1], rtol=0.0, atol=1e-13)


def test_the_gate_looks_at_errors_with_and_without(
    systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 3)
    start = runs.before(known_log(systematic, outage), outage)
    past = past_of(start)
    visible = torch.tensor([n in outage.satellites_visible for n in start.series.satellites])
    model = spec("decay")
    replays = recent_replays(start.run, past.heard, visible, model)
    assert replays is not None
    better, plain = replayed(start, past, replays, visible, model)
    verdict = judged(start, past, visible, model)
    assert verdict.replays == len(better)
    assert verdict.improvement == pytest.approx(1.0 - float(better.sum() / plain.sum()))
    assert not judged(start, past, visible, spec("decay", gate_horizon_s=300.0)).use


def absurd(table: pd.DataFrame, rows: "pd.Series[bool]") -> pd.DataFrame:
    values = {"lat": -0.3, "lon": 2.0, "height": 5e3, "v_e": 340.0, "v_n": -340.0, "azimuth": 3.0}
    values |= {"pseudorange": 3e7, "range_rate": 900.0, "cn0": 60.0}
    table = table.copy()
    for name, value in values.items():
        if name in table:
            table.loc[rows, name] = value
    return table


def test_nothing_of_the_outage_is_seen_but_the_satellites_that_stay(systematic: DriveLog) -> None:
    outage = highest(systematic, 3)
    ranges, fixes, reference = systematic.ranges, systematic.fixes, systematic.reference
    assert ranges is not None
    assert reference is not None
    hidden = (ranges["t"] >= outage.start) & ~ranges["satellite"].isin(outage.satellites_visible)
    hidden |= ranges["t"] > outage.end
    poisoned = replace(
        systematic,
        ranges=absurd(ranges, hidden),
        fixes=absurd(fixes, fixes["t"] >= outage.start),
        reference=absurd(reference, reference["t"] >= outage.start),
    )
    seen = (ranges["t"] >= outage.start) & ranges["satellite"].isin(outage.satellites_visible)
    seen &= ranges["t"] <= outage.end
    moved = replace(systematic, ranges=ranges.assign(cn0=ranges["cn0"] - 3.0 * seen))
    for model in (spec("decay", safeguard={"gate": False}), spec()):

        def solved(log: DriveLog, model: RangeErrorSpec = model) -> Solution:
            return RangeErrorMethod(fresh_runs(), model).predict(known_log(log, outage), outage)

        clean, again = solved(systematic), solved(poisoned)
        assert clean.notes["used"] is True
        pd.testing.assert_frame_equal(again.table, clean.table, check_exact=True)
        assert repr(again.notes) == repr(clean.notes)  # NaN equals itself so
    assert not solved(moved).table["lat"].equals(clean.table["lat"])  # inputs of the outage are
