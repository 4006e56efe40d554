"""Shares of faults caught, beside scipy's interval and a count by hand."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from navlearn.fusion.measurements import Kind, Verdict, rows_of
from navlearn.outages.detection import (
    GOOD,
    detection_by_kind,
    position_verdicts,
    wilson_interval,
)
from navlearn.outages.refused_fixes import Judgements


@pytest.mark.parametrize(("hits", "trials"), [(0, 7), (3, 10), (10, 10), (180, 2000), (1, 1)])
def test_interval_is_that_of_scipy(hits, trials):
    expected = binomtest(hits, trials).proportion_ci(confidence_level=0.95, method="wilson")
    assert wilson_interval(hits, trials) == pytest.approx((expected.low, expected.high), abs=1e-7)


def test_no_trial_no_interval():
    assert np.isnan(wilson_interval(0, 0)).all()


def test_caught_is_refused_or_hardly_weighed():
    verdict = np.array([[1], [2], [4], [5], [6], [3], [0], [1]])
    judged = Judgements(
        t=np.arange(8.0),
        rows=rows_of([(Kind.POSITION, True, 3)], 1),
        kinds=("position",),
        innovation=np.tile([3.0, 4.0, 9.0], (8, 1)),
        nis=np.ones((8, 1)),
        verdict=verdict,
        weight=np.ones((8, 1)),
        stated=np.ones((8, 1)),
        nis_limit=np.array([16.3]),
        limits={},
    )
    faults = pd.DataFrame(
        {"fault": [1, 2], "kind": ["spike", "bias"], "t": [0.0, 2.0], "duration": [0.0, 3.0]}
    )
    fixes = position_verdicts(judged, faults)
    assert fixes["t"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0]
    assert fixes["caught"].tolist() == [False, True, True, True, True, False, False]
    assert set(fixes["innovation"]) == {5.0}
    table = detection_by_kind(judged, faults).set_index("kind")
    assert list(table.index) == ["bias", "spike", GOOD]
    assert table[["fixes", "caught"]].to_numpy().tolist() == [[4, 3], [1, 0], [2, 1]]
    assert Verdict(6) is Verdict.ACCEPTED_WITH_LESS_WEIGHT
