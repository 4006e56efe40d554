"""The table of refused measurements, from judgements written down by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.fusion.measurements import Kind, Verdict, rows_of
from navlearn.outages.refused_fixes import (
    Judgements,
    fault_at,
    fix_errors,
    nearest_rows,
    refused_table,
    verdict_counts,
)
from navlearn.outages.refused_ranges import RangeJudgements, range_counts, refused_ranges_table
from navlearn.outages.track import track_of

NOTHING = np.nan
ROWS = rows_of([(Kind.POSITION, True, 3), (Kind.VELOCITY, True, 2), (Kind.COURSE, True, 1)], 5)
V = Verdict


@pytest.fixture
def judged() -> Judgements:
    """Five moments; the fourth has no fix."""
    verdict = np.zeros((5, 5), dtype=np.int64)
    verdict[:, 0] = [
        V.REFUSED_BY_PREDICTION, V.REFUSED_BY_MOTION, V.ACCEPTED, V.ABSENT, V.ACCEPTED_BY_RESET,
    ]  # fmt: skip
    verdict[:, 1] = [V.ACCEPTED, V.REFUSED_BY_GATE, V.ACCEPTED_WITH_LESS_WEIGHT, V.ABSENT, 1]
    verdict[0, 2] = V.REFUSED_BY_GATE
    innovation = np.full((5, 6), NOTHING)
    innovation[[0, 1, 2, 4]] = [
        [3.0, -4.0, 1.0, 0.1, 0.2, -0.7],
        [-60.0, 80.0, 2.0, 6.0, 8.0, 0.1],
        [0.1, 0.2, 0.3, 1.0, 0.0, 0.1],
        [30.0, 40.0, 5.0, 0.1, 0.1, 0.1],
    ]
    nis = np.where(verdict > 0, 20.0, NOTHING)
    weight = np.ones((5, 5))
    weight[verdict == V.REFUSED_BY_GATE] = 0.0
    weight[[0, 1], 0] = 0.0
    weight[2, 1] = 0.25
    stated = np.full((5, 5), NOTHING)
    stated[:, 0] = 1.5
    return Judgements(
        t=np.array([10.0, 11.0, 12.0, 12.5, 13.0]),
        rows=ROWS,
        kinds=tuple(kind.name.lower() for kind in Kind),
        innovation=innovation,
        nis=nis,
        verdict=verdict,
        weight=weight,
        stated=stated,
        nis_limit=np.array([16.3, 13.8, 10.8, NOTHING, NOTHING]),
        limits={int(V.REFUSED_BY_PREDICTION): 4.5, int(V.REFUSED_BY_MOTION): 25.0},
    )


def test_every_refusal_is_listed_with_its_reason(judged):
    table = refused_table(judged)
    told = table[["t", "kind", "verdict", "innovation", "unit", "weight"]].to_numpy().tolist()
    assert told == [
        [10.0, "course", "refused_by_gate", -0.7, "rad", 0.0],
        [10.0, "position", "refused_by_prediction", 5.0, "m", 0.0],
        [11.0, "position", "refused_by_motion", 100.0, "m", 0.0],
        [11.0, "velocity", "refused_by_gate", 10.0, "m/s", 0.0],
        [12.0, "velocity", "accepted_with_less_weight", 1.0, "m/s", 0.25],
        [13.0, "position", "accepted_by_reset", 50.0, "m", 1.0],
    ]
    assert table["limit_m"].tolist() == pytest.approx(
        [NOTHING, 4.5, 25.0, NOTHING, NOTHING, NOTHING], nan_ok=True
    )
    assert table["nis_limit"].tolist() == [10.8, 16.3, 16.3, 13.8, 13.8, 16.3]
    assert table["up"].tolist() == pytest.approx(
        [NOTHING, 1.0, 2.0, NOTHING, NOTHING, 5.0], nan_ok=True
    )
    assert table["stated_deviation"].count() == 3
    assert (table["fault"] == 0).all()
    assert table["fix_error_m"].isna().all()


def test_counts_are_of_what_was_measured(judged):
    counts = verdict_counts(judged).set_index("kind")
    assert list(counts.index) == ["position", "velocity", "course"]
    assert counts["measured"].tolist() == [4, 4, 1]
    position = counts.loc["position"]
    assert position["accepted"] == position["refused_by_prediction"] == 1
    assert position["refused_by_motion"] == position["accepted_by_reset"] == 1
    assert counts.loc["velocity", "accepted_with_less_weight"] == 1
    assert (counts.drop(columns="measured").sum(axis=1) == counts["measured"]).all()


def test_a_filter_that_refuses_nothing_has_an_empty_table(judged):
    content = np.minimum(judged.verdict, int(V.ACCEPTED))
    table = refused_table(replace(judged, verdict=content))
    assert table.empty
    assert list(table.columns) == list(refused_table(judged).columns)


def test_the_judge_knows_how_far_off_a_fix_was(judged, make_log):
    log = make_log(duration=30.0)
    fixes = log.fixes.copy()
    # 30 m to the north at 11 s, on the ellipsoid's meridian radius of that latitude
    fixes.loc[fixes["t"] == 11.0, "lat"] += 30.0 / 6_361_800.0
    faulty = replace(
        log,
        fixes=fixes,
        metadata=replace(log.metadata, extra={"faults": {"injected": [
            {"fault": 7, "kind": "spike", "first_row": 11, "t": 11.0, "duration": 0.0, "fixes": 1,
             "east": 0.0, "north": 30.0, "up": 0.0, "v_east": 0.0, "v_north": 0.0, "honest": False}
        ]}}),
    )  # fmt: skip
    table = refused_table(judged, faulty).set_index(["kind", "t"])
    assert table.loc[("position", 11.0), "fix_error_m"] == pytest.approx(30.0, abs=0.15)
    assert table.loc[("position", 10.0), "fix_error_m"] == pytest.approx(0.0, abs=1e-6)
    assert table.loc["velocity", "fix_error_m"].isna().all()
    assert table["fault"].to_dict()[("velocity", 11.0)] == 7
    assert table["fault"].sum() == 14


def test_times_are_found_where_they_are(make_log):
    known = np.array([1.0, 2.0, 5.0])
    np.testing.assert_array_equal(
        nearest_rows(np.array([0.9995, 2.0, 4.0, 5.0005, 9.0]), known), [0, 1, -1, 2, -1]
    )
    assert nearest_rows(np.array([1.0]), np.zeros(0)).tolist() == [-1]
    log = make_log(duration=30.0)
    errors = fix_errors(np.array([3.0, 3.5, 99.0]), log.fixes, track_of(log))
    assert errors[0] == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(errors[1:]).all()


def test_a_fault_lasts_from_its_first_fix_to_its_last():
    faults = pd.DataFrame({"fault": [1, 2], "t": [10.0, 20.0], "duration": [0.0, 3.0]})
    t = np.array([9.0, 10.0, 11.0, 20.0, 23.0, 24.0])
    assert fault_at(t, faults).tolist() == [0, 1, 0, 2, 2, 0]
    assert fault_at(t, None).tolist() == [0] * 6


def test_ranges_are_listed_by_satellite():
    verdict = np.array([[1, 2, 0, 1, 1, 0], [1, 1, 1, 1, 2, 3]])
    found = RangeJudgements(
        t=np.array([5.0, 6.0]),
        satellites=("G01", "G07", "E11"),
        innovation=np.arange(12.0).reshape(2, 6),
        nis=np.full((2, 6), 11.0),
        verdict=verdict,
        nis_limit=10.8,
    )
    table = refused_ranges_table(found)
    assert table[["t", "satellite", "kind", "innovation", "unit"]].to_numpy().tolist() == [
        [5.0, "G07", "pseudorange", 1.0, "m"],
        [6.0, "G07", "range_rate", 10.0, "m/s"],
        [6.0, "E11", "range_rate", 11.0, "m/s"],
    ]
    counts = range_counts(found).set_index("kind")
    assert counts["measured"].to_dict() == {"pseudorange": 5, "range_rate": 5}
    assert counts["refused_by_gate"].to_dict() == {"pseudorange": 1, "range_rate": 1}
