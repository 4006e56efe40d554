"""Range-error models on drives: when they act, what they give, and when they are refused."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.experiment.learned import Learned
from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.experiment.tight_method import TightMethod
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.metrics import errors_over_time
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of
from navlearn.recipe.range_error_spec import RangeErrorSpec

MakeSpec = Callable[..., RangeErrorSpec]
Highest = Callable[[DriveLog, int], Outage]


def rms(solution: Solution, log: DriveLog, outage: Outage) -> float:
    error = errors_over_time(solution.table, track_of(log), outage)["horizontal"].to_numpy()
    return float(np.sqrt(np.mean(error**2)))


def test_without_satellites_it_is_the_filter_to_the_last_digit(
    spec: MakeSpec, highest: Highest, systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 0)
    known = known_log(systematic, outage)
    plain = TightMethod(runs).predict(known, outage)
    found = RangeErrorMethod(runs, spec(safeguard={"gate": False})).predict(known, outage)
    pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)
    assert found.notes["used"] is False
    assert "no satellite stays" in str(found.notes["reason"])


def test_where_enough_satellites_stay_there_is_nothing_to_do(
    spec: MakeSpec, highest: Highest, systematic: DriveLog, runs: TightFilterRuns
) -> None:
    outage = highest(systematic, 5)
    known = known_log(systematic, outage)
    plain = TightMethod(runs).predict(known, outage)
    found = RangeErrorMethod(runs, spec(safeguard={"gate": False})).predict(known, outage)
    pd.testing.assert_frame_equal(found.table, plain.table, check_exact=True)
    assert "5 satellites stay" in str(found.notes["reason"])


def test_an_error_that_follows_from_elevation_and_cn0_is_learned_and_helps(
    spec: MakeSpec, highest: Highest, systematic: DriveLog, runs: TightFilterRuns
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
    spec: MakeSpec,
    highest: Highest,
    systematic: DriveLog,
    runs: TightFilterRuns,
    structure: str,
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
    spec: MakeSpec,
    fresh_runs: Callable[[], TightFilterRuns],
    highest: Highest,
    systematic: DriveLog,
    runs: TightFilterRuns,
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


def test_white_errors_are_refused(
    driven: Callable[..., DriveLog],
    spec: MakeSpec,
    fresh_runs: Callable[[], TightFilterRuns],
    highest: Highest,
) -> None:
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
