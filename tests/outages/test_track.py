from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.track import driven, stood, track_from_table, track_of, turned

MakeLog = Callable[..., DriveLog]


def test_fixes_count_when_they_were_valid_not_when_they_were_stamped(
    straight_log: DriveLog,
) -> None:
    bare = replace(straight_log, reference=None)
    late = replace(bare, metadata=replace(bare.metadata, gnss_latency=0.25))
    done = replace(late, metadata=replace(late.metadata, latency_removed=True))
    assert track_of(late).t[5] == pytest.approx(bare.fixes["t"].iloc[5] - 0.25)
    assert track_of(done).t[5] == bare.fixes["t"].iloc[5]
    assert bare.fixes["t"].iloc[0] == 0.0  # the log itself is left alone


def test_course_stands_in_for_azimuth_only_while_the_car_moves(make_log: MakeLog) -> None:
    log = make_log(duration=100.0, speed=lambda t: 0.1 * t, azimuth=6.0)
    track = track_of(replace(log, reference=None))
    assert track.azimuth_source == "course"
    known = np.isfinite(track.azimuth)
    assert np.array_equal(known, 0.1 * track.t >= 3.0)
    assert np.allclose(np.remainder(track.azimuth[known], 2 * np.pi), 6.0)


def test_distance_is_the_integral_of_speed_and_standing_adds_nothing(make_log: MakeLog) -> None:
    log = make_log(duration=200.0, speed=lambda t: np.where(t < 100.0, 0.2 * t, 0.0))
    track = track_of(log)
    assert driven(track)[-1] == pytest.approx(0.1 * 100.0**2, rel=2e-3)
    assert stood(track, 0.5)[-1] == pytest.approx(100.0 + 2.5, abs=0.2)


def test_distance_comes_from_positions_where_velocity_is_unknown(straight_log: DriveLog) -> None:
    assert straight_log.reference is not None
    table = straight_log.reference[["t", "lat", "lon"]]
    track = track_from_table(table, "reference")
    assert track.azimuth_source == "none"
    assert driven(track)[-1] == pytest.approx(9000.0, rel=1e-3)
    assert np.isnan(turned(track)).all()


def test_turned_angle_adds_left_and_right_and_passes_north(make_log: MakeLog) -> None:
    log = make_log(duration=200.0, azimuth=lambda t: -0.5 + 1.0 * np.sin(2 * np.pi * t / 200.0))
    assert log.reference is not None
    wrapped = np.remainder(log.reference["azimuth"], 2 * np.pi)
    track = track_from_table(log.reference.assign(azimuth=wrapped), "truth")
    assert turned(track)[-1] == pytest.approx(4.0, rel=1e-2)


def test_positions_that_are_missing_are_left_out() -> None:
    table = pd.DataFrame({"t": [0.0, 1.0, 2.0], "lat": [0.1, np.nan, 0.1], "lon": [0.2, 0.2, 0.2]})
    assert list(track_from_table(table, "fixes").t) == [0.0, 2.0]
