import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import FilterDivergedError, LogError, ShapeError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.metrics import FIGURES, check_solution, errors_over_time, figures
from navlearn.outages.schedule import Outage
from navlearn.outages.track import track_of

MakeLog = Callable[..., DriveLog]
OUTAGE = Outage(400.0, 60.0)


def solution_of(log: DriveLog, outage: Outage = OUTAGE) -> pd.DataFrame:
    """The truth itself as a solution."""
    assert log.reference is not None
    table = log.reference
    inside = (table["t"] >= outage.start) & (table["t"] <= outage.end)
    names = ["t", "lat", "lon", "height", "v_e", "v_n", "azimuth"]
    return table.loc[inside, names].reset_index(drop=True)


def great_circle(lat_1: float, lon_1: float, lat_2: float, lon_2: float, radius: float) -> float:
    """Haversine distance, written without any of navlearn's geometry."""
    a = math.sin((lat_2 - lat_1) / 2) ** 2
    a += math.cos(lat_1) * math.cos(lat_2) * math.sin((lon_2 - lon_1) / 2) ** 2
    return 2 * radius * math.asin(math.sqrt(a))


def test_the_truth_has_no_error(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    found = figures(errors_over_time(solution_of(straight_log), track, OUTAGE), track, OUTAGE)
    assert tuple(found) == FIGURES
    for name in FIGURES:
        if "error" in name:
            assert found[name] == pytest.approx(0.0, abs=1e-9), name
    assert found["distance_m"] == pytest.approx(600.0, rel=1e-9)
    assert found["turned_deg"] == 0.0
    assert found["reference_samples"] == 601
    assert math.isnan(found["share_in_95_ellipse"])


def test_constant_azimuth_error_grows_cross_track(make_log: MakeLog) -> None:
    """v = 10 m/s, azimuth off by 2°: chord 2 v t sin(1°), across v t sin(2°)."""
    error = math.radians(2.0)
    log = make_log(azimuth=0.5)
    wrong = make_log(azimuth=lambda t: np.where(t < OUTAGE.start, 0.5, 0.5 + error))
    track = track_of(log)
    found = errors_over_time(solution_of(wrong), track, OUTAGE)
    assert found["azimuth"].to_numpy() == pytest.approx(error, abs=1e-12)
    driven = 10.0 * found["since_start"].to_numpy()
    # 5 cm: the turn takes half a sample.
    assert found["cross"].to_numpy() == pytest.approx(driven * math.sin(error), abs=0.05)
    assert found["along"].to_numpy() == pytest.approx(driven * (math.cos(error) - 1), abs=0.05)
    total = figures(found, track, OUTAGE)
    chord = 2.0 * 600.0 * math.sin(error / 2.0)
    assert total["final_horizontal_error_m"] == pytest.approx(chord, abs=0.05)
    assert total["max_horizontal_error_m"] == pytest.approx(chord, abs=0.05)
    assert total["rms_horizontal_error_m"] == pytest.approx(chord / math.sqrt(3.0), rel=0.01)
    assert total["final_horizontal_error_percent"] == pytest.approx(chord / 6.0, rel=0.01)
    assert total["final_cross_track_error_m"] > 0.0  # azimuth too large: to the right
    assert total["max_azimuth_error_deg"] == pytest.approx(2.0)
    assert total["max_velocity_error_m_per_s"] == pytest.approx(20.0 * math.sin(error / 2.0))


def test_too_high_a_speed_is_an_error_ahead(make_log: MakeLog) -> None:
    log = make_log(azimuth=2.5)
    fast = make_log(azimuth=2.5, speed=lambda t: np.where(t <= OUTAGE.start, 10.0, 10.2))
    track = track_of(log)
    total = figures(errors_over_time(solution_of(fast), track, OUTAGE), track, OUTAGE)
    assert total["final_along_track_error_m"] == pytest.approx(0.2 * 60.0, abs=0.02)
    assert total["final_cross_track_error_m"] == pytest.approx(0.0, abs=0.01)


def test_horizontal_error_agrees_with_the_great_circle(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    moved = solution_of(straight_log)
    shift = 1e-5
    moved = moved.assign(lat=moved["lat"] + shift, lon=moved["lon"] + shift)
    errors = errors_over_time(moved, track, OUTAGE)
    truth = solution_of(straight_log).iloc[-1]
    # A sphere with the local radius; the ellipsoid's radii differ by less than 0.7 %.
    expected = great_circle(
        truth["lat"], truth["lon"], truth["lat"] + shift, truth["lon"] + shift, 6_378_000.0
    )
    assert errors["horizontal"].iloc[-1] == pytest.approx(expected, rel=0.007)


def test_azimuth_error_is_the_short_way_round(make_log: MakeLog) -> None:
    log = make_log(azimuth=3.1)
    track = track_of(log)
    around = solution_of(log).assign(azimuth=-3.1)
    found = errors_over_time(around, track, OUTAGE)["azimuth"].to_numpy()
    assert found == pytest.approx(2.0 * math.pi - 6.2)


def test_wrapped_solutions_are_interpolated_across_south(make_log: MakeLog) -> None:
    log = make_log(azimuth=lambda t: 3.0 + 0.01 * (t - OUTAGE.start))
    track = track_of(log)
    sparse = solution_of(log).iloc[::7]
    wrapped = np.remainder(sparse["azimuth"] + np.pi, 2 * np.pi) - np.pi
    sparse = sparse.assign(azimuth=wrapped)
    assert errors_over_time(sparse, track, OUTAGE)["azimuth"].abs().max() < 1e-9


def test_sparse_solutions_are_interpolated_at_the_reference(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    sparse = solution_of(straight_log).iloc[::10]
    assert errors_over_time(sparse, track, OUTAGE)["horizontal"].max() < 1e-3


def test_height_and_unknown_height(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    high = solution_of(straight_log).assign(height=103.0)
    found = figures(errors_over_time(high, track, OUTAGE), track, OUTAGE)
    assert found["max_height_error_m"] == found["rms_height_error_m"] == pytest.approx(3.0)
    unknown = replace(track, height=np.full_like(track.height, np.nan))
    found = figures(errors_over_time(high, unknown, OUTAGE), unknown, OUTAGE)
    assert math.isnan(found["final_height_error_m"])
    assert found["max_horizontal_error_m"] < 1e-3


def test_ellipse_holds_the_truth_as_often_as_it_should(straight_log: DriveLog) -> None:
    """Errors drawn from the covariance that the solution claims: 95 % inside."""
    rng = np.random.default_rng(3)
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    log, track = straight_log, track_of(straight_log)
    outage = Outage(100.0, 700.0)
    truth = solution_of(log, outage)
    east, north = rng.multivariate_normal([0.0, 0.0], covariance, size=len(truth)).T
    lat = truth["lat"] + north / 6_361_600.0  # meridian radius at 40°
    lon = truth["lon"] + east / (6_386_900.0 * np.cos(truth["lat"]))
    claimed = truth.assign(lat=lat, lon=lon, std_e=2.0, std_n=1.0, cov_en=1.5)
    found = figures(errors_over_time(claimed, track, outage), track, outage)
    assert found["share_in_95_ellipse"] == pytest.approx(0.95, abs=3 * math.sqrt(0.0475 / 7001))
    proud = claimed.assign(std_e=1.0, std_n=0.5, cov_en=0.375)  # a quarter of the covariance
    found = figures(errors_over_time(proud, track, outage), track, outage)
    assert found["share_in_95_ellipse"] == pytest.approx(1 - 0.05**0.25, abs=0.02)


def test_an_ellipse_is_turned_the_right_way(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    truth = solution_of(straight_log)
    north_east = truth.assign(
        lat=truth["lat"] + 2.0 / 6.37e6, lon=truth["lon"] + 2.0 / 6.37e6 / np.cos(truth["lat"])
    )
    narrow = {"std_e": 1.0, "std_n": 1.0}
    along = errors_over_time(north_east.assign(**narrow, cov_en=0.9), track, OUTAGE)
    across = errors_over_time(north_east.assign(**narrow, cov_en=-0.9), track, OUTAGE)
    assert along["in_ellipse"].min() == 1.0
    assert across["in_ellipse"].max() == 0.0


def test_unknown_reference_values_are_left_out(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    azimuth = track.azimuth.copy()
    azimuth[(track.t > 410.0)] = np.nan
    track = replace(track, azimuth=azimuth)
    wrong = solution_of(straight_log)
    wrong = wrong.assign(azimuth=wrong["azimuth"] + 0.01 * (wrong["t"] - OUTAGE.start))
    found = figures(errors_over_time(wrong, track, OUTAGE), track, OUTAGE)
    assert found["max_azimuth_error_deg"] == pytest.approx(math.degrees(0.1))
    assert found["final_azimuth_error_deg"] == pytest.approx(math.degrees(0.1))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda s: s.drop(columns="azimuth"), ShapeError, r"missing columns \['azimuth'\]"),
        (lambda s: s.iloc[:0], ShapeError, "0 rows"),
        (lambda s: s.iloc[::-1], ShapeError, "sort it by t"),
        (lambda s: s.iloc[:-30], LogError, "from 400 to 457 s; expected 400 to 460 s"),
        (lambda s: s.iloc[30:], LogError, "from 403 to 460"),
        (lambda s: s.assign(lat=s["lat"].where(s["t"] < 430)), FilterDivergedError, "from 430 s"),
    ],
)
def test_what_is_no_solution_is_refused(
    straight_log: DriveLog,
    change: Callable[[pd.DataFrame], pd.DataFrame],
    error: type[Exception],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        check_solution(change(solution_of(straight_log)), OUTAGE)


def test_an_outage_without_reference_is_refused(straight_log: DriveLog) -> None:
    track = track_of(straight_log)
    keep = (track.t < 390.0) | (track.t > 470.0)
    hollow = replace(
        track,
        **{
            name: getattr(track, name)[keep]
            for name in ("t", "lat", "lon", "height", "v_e", "v_n", "azimuth")
        },
    )
    with pytest.raises(LogError, match="truth has no position in it"):
        errors_over_time(solution_of(straight_log), hollow, OUTAGE)
