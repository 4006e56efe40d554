"""What a range-error model may see of an outage: the satellites that stay, and no more."""

from collections.abc import Callable
from dataclasses import replace

import pandas as pd

from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.replay import Solution
from navlearn.outages.schedule import Outage
from navlearn.recipe.range_error_spec import RangeErrorSpec


def absurd(table: pd.DataFrame, rows: "pd.Series[bool]") -> pd.DataFrame:
    values = {"lat": -0.3, "lon": 2.0, "height": 5e3, "v_e": 340.0, "v_n": -340.0, "azimuth": 3.0}
    values |= {"pseudorange": 3e7, "range_rate": 900.0, "cn0": 60.0}
    table = table.copy()
    for name, value in values.items():
        if name in table:
            table.loc[rows, name] = value
    return table


def test_nothing_of_the_outage_is_seen_but_the_satellites_that_stay(
    spec: Callable[..., RangeErrorSpec],
    fresh_runs: Callable[[], TightFilterRuns],
    highest: Callable[[DriveLog, int], Outage],
    systematic: DriveLog,
) -> None:
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
