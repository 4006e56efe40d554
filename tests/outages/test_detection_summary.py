"""What several drives tell together, and the figures of it."""

import numpy as np
import pandas as pd
import pytest

from navlearn.outages.detection_plots import plot_detection, plot_operating_curves
from navlearn.outages.detection_summary import rms_by_drive


def drives(count, spread):
    rng = np.random.default_rng(5)
    rms = 2.0 + spread * rng.standard_normal(count)
    return pd.DataFrame(
        {
            "alarms": rng.binomial(1000, 0.02, count),
            "good": 1000,
            "squares": rms**2 * 500.0,
            "times": 500,
            "near_squares": 0.0,
            "near": 0,
            "worst": np.arange(count, dtype=np.float64),
        }
    )


def ends(told):
    return [float(one) for one in told.split("(")[1].rstrip(")").split("-")]


def test_drives_that_are_alike_leave_no_doubt():
    told = rms_by_drive(drives(12, 0.0))
    assert told["RMS m"] == "2.00 (2.00-2.00)"
    assert told["RMS near m"] == "–"
    assert told["worst m"] == "5.5"


def test_intervals_are_about_as_wide_as_students():
    table = drives(40, 0.3)
    low, high = ends(rms_by_drive(table)["RMS m"])
    squares = table["squares"] / table["times"]
    half = 2.02 * squares.std() / np.sqrt(40.0)
    expected = np.sqrt([squares.mean() - half, squares.mean() + half])
    assert (low, high) == pytest.approx(tuple(expected), abs=0.03)
    rate = rms_by_drive(table)["false alarms %"]
    assert float(rate.split()[0]) == pytest.approx(table["alarms"].sum() / 400.0, abs=0.005)
    low, high = ends(rate)
    assert low < table["alarms"].sum() / 400.0 < high


def test_one_drive_has_no_interval():
    assert rms_by_drive(drives(1, 0.0))["RMS m"] == "2.00"


def test_figures_are_drawn(tmp_path):
    rows = [
        {"kind": kind, "way": way, "size": size, "share": share, "low": share / 2.0, "high": 1.0,
         "limit": limit, "alarms": 0.01 * limit}
        for kind in ("spike", "step")
        for way in ("χ² gate", "Huber")
        for limit in (1.0, 2.0)
        for size, share in ((2.0, 0.1), (20.0, 0.8), (np.nan, 0.5))
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    for draw in (plot_detection, plot_operating_curves):
        path = draw(tmp_path / f"{draw.__name__}.png", table)
        assert path.stat().st_size > 10_000
