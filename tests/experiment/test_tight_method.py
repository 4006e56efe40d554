"""The tightly coupled filter as a method: shared up to the outage, loose where nothing is heard."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import LogError
from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.sensors_needed import check_sensors
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.experiment.tight_method import TightMethod
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import simulate_drive
from navlearn.outages.known_log import known_log
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.states import FixTiming, GnssFix, InsState
from navlearn.tight_navigator import tight_belief_at

START, LENGTH = 240.0, 40.0


@pytest.fixture(scope="module")
def log() -> DriveLog:
    """A drive with ranges."""
    drive = simulate_drive(
        profile="mixed",
        grade="mems_m",
        duration=300.0,
        seed=11,
        imu_rate_hz=10.0,
        satellites="suburban",
    )
    return drive.log


def recipe(**sections: Any) -> Recipe:
    return Recipe.model_validate(
        {"name": "one", "log": {"path": "a"}, "methods": ["tc_ekf"], **sections}
    )


IMU = {"mechanization": {"sensors": "imu", "imu_rate_hz": 10.0}}


def satellites_at(log: DriveLog, t: float) -> tuple[str, ...]:
    assert log.ranges is not None
    heard = log.ranges[(log.ranges["t"] - t).abs() < 0.5]
    return tuple(heard["satellite"].unique())


@pytest.mark.parametrize("sections", [{}, IMU], ids=["riss", "imu"])
def test_without_satellites_the_outage_is_that_of_the_loosely_coupled_filter(
    log: DriveLog, sections: dict[str, Any]
) -> None:
    outage = Outage(START, LENGTH)
    start = TightFilterRuns(recipe(**sections)).before(known_log(log, outage), outage)
    tight = start.through()
    belief = tight_belief_at(start.run.history, -1).vehicle
    full = bool(sections)
    loose = InsEkf if full else LooselyCoupledEkf
    none = start.t[:0]
    with torch.no_grad():
        history = loose(start.navigator.options.vehicle)(  # type: ignore[arg-type]
            belief,
            start.samples,
            GnssFix(*(none for _ in GnssFix._fields)),
            FixTiming(none.to(torch.int64), none),
            method=tight.method,
        )
    assert int(start.timing.index.numel()) == 0
    for name in ("lat", "lon"):
        off = 6.4e6 * (getattr(tight.trajectory, name) - getattr(history.trajectory, name))
        assert float(off.abs().max()) < 1e-4
    P = history.belief.covariance[-1]
    torch.testing.assert_close(
        tight.belief.vehicle.covariance[-1], P, rtol=1e-6, atol=1e-9 * float(P.max())
    )
    assert isinstance(tight.trajectory, InsState) == full


def test_what_lies_before_an_outage_is_filtered_once(log: DriveLog) -> None:
    runs = TightFilterRuns(recipe())
    method, tables = TightMethod(runs), {}
    for count in (0, 1, 3):
        outage = Outage(START, LENGTH, satellites_at(log, START)[:count])
        solution = method.predict(known_log(log, outage), outage)
        tables[count] = solution.table
        assert len(str(solution.notes["satellites_used"]).split()) == count
    assert len(runs._made) == 1
    after = [table.iloc[-1] for table in tables.values()]
    assert len({float(row["lat"]) for row in after}) == 3
    assert after[2]["std_e"] < after[0]["std_e"]


def test_an_outage_in_which_all_stay_is_none(log: DriveLog) -> None:
    every = tuple(log.ranges["satellite"].unique())  # type: ignore[index]
    outage = Outage(START, LENGTH, every)
    runs = TightFilterRuns(recipe())
    table = TightMethod(runs).predict(known_log(log, outage), outage).table
    line, _, _, run = runs.run(log)
    t = line.t[run.first :].numpy()
    at = np.searchsorted(t, table["t"].to_numpy())
    lat = run.history.trajectory.lat.numpy()[np.minimum(at, t.size - 1)]
    assert np.abs(6.4e6 * (table["lat"].to_numpy() - lat)).max() < 0.005


@pytest.mark.parametrize("faster", [False, True])
def test_a_reception_just_before_the_start_is_of_the_past(log: DriveLog, faster: bool) -> None:
    """It is used at an interval's end after the start, even beside the outage's own first one."""
    ranges = log.ranges
    assert ranges is not None
    late = ranges.assign(t=ranges["t"] + 0.06)
    if faster:
        late = pd.concat((ranges.assign(t=ranges["t"] + 0.13), late)).sort_values("t")
    late = replace(log, ranges=late.reset_index(drop=True))
    outage = Outage(START + 0.08, LENGTH, satellites_at(log, START)[:2])
    known, runs = known_log(late, outage), TightFilterRuns(recipe())
    start = runs.before(known, outage)
    assert bool((start.received >= outage.start).all()) is not faster
    assert len(start.received) == len(start.ranges.pseudorange)
    plain = TightMethod(runs).predict(known, outage)
    if not faster:
        assert str(plain.notes["satellites_used"]).split() == sorted(outage.satellites_visible)
    content = {"name": "a", "structure": "decay", "window_s": 150.0, "safeguard": {"gate": False}}
    model = RangeErrorSpec.model_validate(content)
    assert RangeErrorMethod(runs, model).predict(known, outage).notes["used"] is True


def test_a_log_without_ranges_is_refused(log: DriveLog) -> None:
    with pytest.raises(LogError, match=r"tc_ekf cannot run: the log has no raw ranges"):
        check_sensors(recipe(), replace(log, ranges=None))
