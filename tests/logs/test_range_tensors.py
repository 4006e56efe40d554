"""Ranges as tensors, against distances that are written down one satellite at a time."""

import math

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import LogMetadata
from navlearn.logs.range_checks import checked_ranges
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import ranges_from_table

EDGES = np.arange(601) / 10.0
LAT, LON, HEIGHT = math.radians(52.5), math.radians(13.4), 80.0
C, EARTH_RATE = 299792458.0, 7.292115e-5
EVERY = ("satellite_clock", "ionosphere", "troposphere", "earth_rotation")
SKY = {
    "G02": (30.0, 20.0),
    "G11": (75.0, 110.0),
    "G24": (12.0, 200.0),
    "R03": (50.0, 300.0),
    "G07": (40.0, 250.0),
    "R11": (25.0, 60.0),
    "G30": (3.0, 330.0),
}


def antenna():
    a, e2 = 6378137.0, 0.00669437999014
    n = a / math.sqrt(1.0 - e2 * math.sin(LAT) ** 2)
    level = (n + HEIGHT) * math.cos(LAT)
    return np.array(
        [level * math.cos(LON), level * math.sin(LON), ((1.0 - e2) * n + HEIGHT) * math.sin(LAT)]
    )


def in_the_sky(elevation_deg, azimuth_deg, far=2.2e7):
    el, az = math.radians(elevation_deg), math.radians(azimuth_deg)
    east, north, up = math.cos(el) * math.sin(az), math.cos(el) * math.cos(az), math.sin(el)
    sp, cp, sl, cl = math.sin(LAT), math.cos(LAT), math.sin(LON), math.cos(LON)
    way = (
        east * np.array([-sl, cl, 0.0])
        + north * np.array([-sp * cl, -sp * sl, cp])
        + up * np.array([cp * cl, cp * sl, sp])
    )
    return antenna() + far * way


def table(times, sky=SKY, clock=3000.0, offset=40.0):
    rows = []
    for t in times:
        for name, (el, az) in sky.items():
            at = in_the_sky(el, az + 0.01 * t)
            own = clock + 2.0 * t + (offset if name[0] == "R" else 0.0)
            rows.append((t, name, np.linalg.norm(at - antenna()) + own, *at))
    columns = ["t", "satellite", "pseudorange", "sat_x", "sat_y", "sat_z"]
    return pd.DataFrame(rows, columns=columns)


def log_with(corrections=EVERY, **more):
    return LogMetadata(name="made", range_corrections=corrections, **more)


def series(frame, metadata=None, options=None, near=None, edges=EDGES):
    return ranges_from_table(
        checked_ranges("made", frame), metadata or log_with(), edges, options, near
    )


def test_every_satellite_keeps_its_slot():
    times = np.arange(20.0)
    frame = table(times)
    frame = frame[~((frame["satellite"] == "G11") & (frame["t"] > 4.0))]
    found = series(frame)
    assert found.satellites == ("G02", "G07", "G11", "G24", "G30", "R03", "R11")
    assert found.systems == ("G", "R")
    assert found.ranges.system.tolist() == [0, 0, 0, 0, 0, 1, 1]
    assert found.ranges.pseudorange.shape == (20, 7)
    assert found.ranges.has_range[:, 2].tolist() == [1.0] * 5 + [0.0] * 15
    for row in frame.itertuples():
        m, s = int(row.t), found.satellites.index(row.satellite)
        assert found.ranges.pseudorange[m, s] == row.pseudorange
        assert found.ranges.satellite[m, s].tolist() == [row.sat_x, row.sat_y, row.sat_z]
    assert all(part.isfinite().all() for part in found.ranges)
    np.testing.assert_array_equal(found.t, times)
    np.testing.assert_array_equal(found.timing.index[1:], 10 * times[1:] - 1)


def test_elevations_are_those_of_the_sky_and_low_satellites_are_left_out():
    found = series(table([1.0, 2.0]))
    truth = [SKY[name][0] for name in found.satellites]
    # the receiver was found from its own ranges
    np.testing.assert_allclose(found.ranges.elevation[0].rad2deg(), truth, atol=1e-6)
    assert found.ranges.has_range[0].tolist() == [1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0]
    higher = series(table([1.0]), options=RangeOptions(least_elevation=math.radians(26.0)))
    assert higher.ranges.has_range[0].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0]


def test_what_is_not_told_is_assumed():
    frame = table([1.0]).assign(range_rate=np.nan, cn0=np.nan, std_range=np.nan)
    frame.loc[0, ["range_rate", "cn0", "std_range"]] = (12.5, 33.0, 7.0)
    for axis in "xyz":
        frame[f"sat_v{axis}"] = 100.0
    found = series(frame).ranges
    assert found.has_rate[0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert found.cn0[0].tolist() == [33.0] + [45.0] * 6
    assert found.std_range[0].tolist() == [7.0] + [0.0] * 6
    weak = series(frame, options=RangeOptions(least_cn0=35.0)).ranges
    assert weak.has_range[0, 0] == weak.has_rate[0, 0] == 0.0
    # a rate without the satellite's velocity says nothing
    still = series(frame.drop(columns=["sat_vx", "sat_vy", "sat_vz"])).ranges
    assert still.has_rate.sum() == 0.0
    assert still.has_range.sum() == 6.0


def test_corrections_that_a_log_names_are_not_made_again():
    frame = table([1.0, 2.0]).assign(
        sat_clock=5e4, ionosphere=4.0, troposphere=3.0, sat_clock_rate=0.5, range_rate=10.0
    )
    done = series(frame)
    np.testing.assert_array_equal(done.ranges.pseudorange[0, 0], frame["pseudorange"][0])
    assert set(done.corrections.values()) == {"in the log"}
    left = series(frame, log_with(("earth_rotation",)), near=(LAT, LON, HEIGHT))
    expected = done.ranges.pseudorange + 5e4 - 4.0 - 3.0
    np.testing.assert_allclose(left.ranges.pseudorange, expected, rtol=0.0, atol=1e-8)
    np.testing.assert_array_equal(left.ranges.range_rate, np.full((2, 7), 10.5))
    assert left.corrections == {
        "satellite_clock": "column",
        "ionosphere": "column",
        "troposphere": "column",
        "earth_rotation": "in the log",
    }


def test_models_stand_in_for_columns():
    frame = table([1.0])
    told = (1.2e-8, 1.5e-8, -6e-8, -1.2e-7, 9.6e4, 1.3e5, -6.6e4, -4.6e5)
    known = log_with(("satellite_clock", "earth_rotation"), klobuchar=told, gps_time_origin=9e8)
    found = series(frame, known, near=(LAT, LON, HEIGHT))
    assert found.corrections["ionosphere"] == "klobuchar"
    assert found.corrections["troposphere"] == "saastamoinen"
    late = torch.tensor([[*frame["pseudorange"]]])[:, [0, 4, 1, 2, 6, 3, 5]]
    late = (late - found.ranges.pseudorange)[0]
    # some 2.4 m of air and at least 1.5 m of ionosphere overhead, more at lower elevations
    order = np.argsort(-found.ranges.elevation[0].numpy())
    assert (np.diff(late[order][:5]) > 0.0).all()
    assert 3.8 < late[2] < 6.5
    assert 15.0 < late[3] < 30.0
    blind = series(frame, log_with(("satellite_clock", "earth_rotation")))
    assert blind.corrections["ionosphere"] == "none"


def test_the_earth_turns_while_the_signal_travels():
    """Satellites as sent are the true ones turned back by ω τ, written here by hand."""
    frame = table([5.0]).assign(sat_vx=1000.0, sat_vy=-2000.0, sat_vz=500.0, range_rate=0.0)
    sent = frame.copy()
    for row in range(len(frame)):
        at = frame.loc[row, ["sat_x", "sat_y", "sat_z"]].to_numpy(float)
        angle = EARTH_RATE * np.linalg.norm(at - antenna()) / C
        c, s = math.cos(angle), math.sin(angle)
        sent.loc[row, ["sat_x", "sat_y"]] = (c * at[0] - s * at[1], s * at[0] + c * at[1])
    assert np.abs(sent["sat_x"] - frame["sat_x"]).max() > 20.0
    truth = series(frame).ranges
    for near in ((LAT, LON, HEIGHT), (LAT + 1e-3, LON, 0.0), None):
        found = series(sent, log_with(EVERY[:3]), near=near)
        assert found.corrections["earth_rotation"] == "rotated"
        error = (found.ranges.satellite - truth.satellite)[..., :].norm(dim=-1)
        assert error.max() < (1e-6 if near == (LAT, LON, HEIGHT) else 0.05)
        turned = found.ranges.satellite_velocity.norm(dim=-1)
        np.testing.assert_allclose(turned, math.sqrt(5.25e6), rtol=1e-12)
        assert (found.ranges.satellite_velocity[..., 0] != 1000.0).all()


def test_nothing_depends_on_what_comes_later():
    frame = table(np.arange(0.0, 55.0, 0.7))
    frame = frame[(frame["t"] > 3.0) | frame["satellite"].isin(["G02", "G11", "G24"])]
    fixes = pd.DataFrame({"t": np.arange(20.0, 60.0), "lat": LAT, "lon": LON, "height": 75.0})
    fixes["lat"] += 1e-5 * np.arange(40)
    for near in (None, fixes):
        whole = series(frame, log_with(("satellite_clock",)), near=near)
        # three satellites and nothing before: where the car is, is not known
        assert whole.ranges.has_range[whole.t <= 3.0].sum() == 0.0
        assert (whole.ranges.has_range[whole.t > 3.5].sum(-1) == 6.0).all()
        for last in (2.0, 15.03, 30.0):
            known = near if near is None else near[near["t"] <= last]
            edges = np.arange(int(10.0 * last) + 1) / 10.0
            part = series(
                frame[frame["t"] <= last], log_with(("satellite_clock",)), near=known, edges=edges
            )
            slots = [whole.satellites.index(name) for name in part.satellites]
            count = len(part.t)
            assert count > 2
            for name, now in part.ranges._asdict().items():
                then = getattr(whole.ranges, name)
                if name == "system":
                    continue
                np.testing.assert_array_equal(now, then[:count][:, slots], err_msg=name)
            np.testing.assert_array_equal(part.timing.index, whole.timing.index[:count])
            np.testing.assert_array_equal(part.timing.delay, whole.timing.delay[:count])


def test_a_wild_range_does_not_move_the_receiver_far():
    frame = table(np.arange(3.0))
    frame.loc[(frame["satellite"] == "G07"), "pseudorange"] += 20000.0
    found = series(frame)
    truth = series(table(np.arange(3.0))).ranges.elevation
    assert (found.ranges.elevation - truth).abs().max() < 1e-4


@pytest.mark.parametrize("wild", [{"G02": 3e6}, {"G02": 3e6, "G07": 2e6, "R03": -4e6}])
def test_a_place_that_wild_ranges_make_up_is_not_believed(wild):
    # one satellite to spare: a fault can be seen, and not be found
    sky = {name: place for name, place in SKY.items() if name != "G30"}
    frame = table(np.arange(0.0, 40.0), sky, offset=0.0)
    broken = frame["t"].between(10.0, 19.5)
    for name, off in wild.items():
        frame.loc[broken & (frame["satellite"] == name), "pseudorange"] += off
    found = series(frame)
    truth = [sky[name][0] for name in found.satellites]
    np.testing.assert_allclose(found.ranges.elevation[15].rad2deg(), truth, atol=0.3)


def test_options_choose_satellites():
    frame = table([1.0, 1.04, 2.0])
    found = series(frame, options=RangeOptions(systems="R"))
    assert (found.satellites, found.systems) == (("R03", "R11"), ("R",))
    without = series(frame, options=RangeOptions(without=("G02", "R03")))
    assert without.satellites == ("G07", "G11", "G24", "G30", "R11")
    # two receptions may be used at the end of one interval
    assert without.timing.index.tolist() == [9, 9, 19]
    np.testing.assert_allclose(without.timing.delay, [0.0, -0.04, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"systems": "GX"}, "systems: found 'GX'"),
        ({"systems": ""}, "systems: found ''"),
        ({"without": ("G07", "G7")}, "without: found 'G7'; expected satellites such as G07"),
        ({"least_elevation": 5.0}, "least_elevation: found 5.0; expected within ±90°, in rad"),
        ({"least_elevation": math.nan}, "least_elevation: found nan"),
        ({"unknown_cn0": math.nan}, "unknown_cn0: found nan; expected dB-Hz"),
    ],
)
def test_options_without_meaning(options, said):
    with pytest.raises(ConfigError, match=said):
        RangeOptions(**options)


def test_no_satellite_at_all_is_no_error():
    nothing = series(table([1.0]).iloc[:0])
    assert nothing.ranges.pseudorange.shape == (0, 0)
    assert nothing.systems == ()
    none_chosen = series(table([1.0]), options=RangeOptions(systems="E"))
    assert none_chosen.timing.index.shape == (0,)


def test_satellite_clocks_must_be_known():
    with pytest.raises(LogError, match="made: ranges have no column sat_clock"):
        series(table([1.0]), log_with(("ionosphere",)))
