"""Raw ranges of the Kingston drive against where its reference says the car was."""

from pathlib import Path

import numpy as np
import pytest
import torch

from navlearn import frames
from navlearn.logs.range_tensors import RangeSeries, ranges_of
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at

DATASETS = Path(__file__).resolve().parents[2] / "datasets"


def off(series: RangeSeries, log) -> tuple[np.ndarray, np.ndarray]:
    """Return pseudoranges and range rates less those of the reference and of the receiver clock."""
    at = reference_at(log, series.t)
    lat, lon, height, *v_l = (
        torch.tensor(at[name].to_numpy()) for name in ("lat", "lon", "height", "v_e", "v_n", "v_u")
    )
    away = series.ranges.satellite - frames.ecef_from_geodetic(lat, lon, height).unsqueeze(1)
    far = away.norm(dim=-1)
    turn = frames.enu_from_ecef_matrix(lat, lon)
    velocity = torch.einsum("mji,mj->mi", turn, torch.stack(v_l, -1)).unsqueeze(1)
    closing = ((series.ranges.satellite_velocity - velocity) * away).sum(-1) / far
    found = []
    for left, has in (
        (series.ranges.pseudorange - far, series.ranges.has_range),
        (series.ranges.range_rate - closing, series.ranges.has_rate),
    ):
        rows = torch.where(has > 0.0, left, torch.nan).numpy()
        rows = rows[np.isfinite(rows).sum(axis=1) > 3]
        rows = np.abs(rows - np.nanmedian(rows, axis=1, keepdims=True))
        found.append(rows[np.isfinite(rows)])
    return found[0], found[1]


@pytest.fixture(scope="module")
def kingston():
    try:
        return read_log(DATASETS / "kingston_2008.yaml")
    except FileNotFoundError as problem:
        pytest.skip(f"the log is not here: {problem}")


def edges(log) -> np.ndarray:
    return np.arange(0.0, log.imu["t"].iloc[-1], 0.1)


def test_what_the_corrections_leave(kingston):
    series = ranges_of(kingston, edges(kingston))
    assert series.systems == ("G",)
    ranges, rates = off(series, kingston)
    assert np.median(ranges) < 0.75
    assert np.quantile(ranges, 0.95) < 2.4
    assert np.median(rates) < 0.018
    assert np.quantile(rates, 0.95) < 0.12


@pytest.mark.parametrize(
    ("column", "source", "median", "most"),
    [("ionosphere", "klobuchar", 1.4, 3.7), ("troposphere", "saastamoinen", 0.75, 2.4)],
)
def test_models_come_near_to_what_the_laboratory_computed(kingston, column, source, median, most):
    bare = kingston.with_tables({"ranges": kingston.ranges.drop(columns=[column])})
    series = ranges_of(bare, edges(bare))
    assert series.corrections[column] == source
    ranges, _ = off(series, bare)
    assert np.median(ranges) < median
    assert np.quantile(ranges, 0.95) < most


def test_where_the_receiver_is_follows_from_its_ranges(kingston):
    """Elevations seen from the fixes, and from nothing but ranges."""
    told = ranges_of(kingston, edges(kingston))
    alone = ranges_of(kingston.with_tables({"fixes": kingston.fixes.iloc[:0]}), edges(kingston))
    both = (told.ranges.has_range > 0.0) & (alone.ranges.has_range > 0.0)
    assert both.double().sum() > 0.999 * told.ranges.has_range.sum()
    assert (told.ranges.elevation - alone.ranges.elevation)[both].abs().max() < 1e-4
    assert (told.ranges.pseudorange - alone.ranges.pseudorange)[both].abs().max() < 1e-6
