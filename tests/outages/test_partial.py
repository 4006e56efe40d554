"""Partial outages: the satellites that stay, by rule, and the outages that are left out."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.placement import place_outages
from navlearn.outages.receptions import receptions_of
from navlearn.outages.schedule import OutageProtocol, Placement
from navlearn.outages.sky import sky_at
from navlearn.outages.track import track_of

MakeLog = Callable[..., DriveLog]
WithRanges = Callable[..., DriveLog]
Directions = Mapping[str, tuple[float, float]]


def direction(elevation: float, azimuth: float) -> np.ndarray:
    e, a = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(e) * math.sin(a), math.cos(e) * math.cos(a), math.sin(e)])


@pytest.fixture(scope="module")
def plain(make_log: MakeLog) -> DriveLog:
    return make_log(duration=600.0, azimuth=lambda t: 0.5 + 0.3 * np.sin(t / 20.0))


@pytest.fixture(scope="module")
def log(plain: DriveLog, with_ranges: WithRanges) -> DriveLog:
    return with_ranges(plain)


def placed(log: DriveLog, **rules: object) -> Placement:
    return place_outages(OutageProtocol(**{"count": 3, "warm_up": 100.0, **rules}), log)


def test_directions_are_those_of_the_sky(log: DriveLog, sky: Directions) -> None:
    found = sky_at(log.ranges, 200.0, track_of(log))
    assert found.names == tuple(sorted(sky))
    for k, name in enumerate(found.names):
        elevation, azimuth = sky[name]
        assert math.degrees(found.elevation[k]) == pytest.approx(elevation, abs=1e-6)
        assert math.degrees(found.azimuth[k]) % 360.0 == pytest.approx(azimuth, abs=1e-6)
        np.testing.assert_allclose(found.unit[k], direction(elevation, azimuth), atol=1e-9)


@pytest.mark.parametrize(
    ("count", "expected"),
    [(0, ()), (1, ("G01",)), (2, ("G01", "G02")), (3, ("G01", "G02", "G03"))],
)
def test_the_highest_stay(log: DriveLog, count: int, expected: tuple[str, ...]) -> None:
    found = placed(log, satellites=count)
    assert [outage.satellites_visible for outage in found.outages] == [expected] * 3
    told = " ".join(found.notes)
    assert ("the highest (`highest`)" in told) == (count > 0)
    for outage in found.outages:
        assert (f"{outage.start:g} s: {' '.join(expected)}" in told) == (count > 0)


def test_low_satellites_and_those_lost_through_the_outage_do_not_stay(
    plain: DriveLog, with_ranges: WithRanges, sky: Directions
) -> None:
    # 61 receptions from 300 to 360 s; seven of them lost are 11.5 %, six are 9.8 %.
    def lost(name: str, t: np.ndarray) -> np.ndarray:
        first, last = {"G01": (310, 316), "G02": (310, 315)}.get(name, (-1, -1))
        return (t >= first) & (t <= last)

    drive = with_ranges(plain, lost)
    rules = {"placement": "listed", "times": (300.0, 400.0), "satellites": 6}
    seven = placed(drive, **{**rules, "min_elevation": 0.0})
    assert seven.outages[0].satellites_visible == tuple(sorted(set(sky) - {"G01"}))
    five = placed(drive, **{**rules, "satellites": 5})
    assert five.outages[0].satellites_visible == tuple(sorted(set(sky) - {"G01", "G07"}))
    assert five.outages[1].satellites_visible == tuple(sorted(set(sky) - {"R06", "G07"}))


def test_an_outage_with_too_few_satellites_is_excluded_and_says_so(
    plain: DriveLog, with_ranges: WithRanges
) -> None:
    def lost(name: str, t: np.ndarray) -> np.ndarray:
        kept = name in ("G01", "G02")
        return (t >= 400.0) & (t <= 470.0) & (not kept)

    drive = with_ranges(plain, lost)
    rules = {"placement": "listed", "times": (300.0, 405.0, 500.0)}
    found = placed(drive, **rules, satellites=3)
    assert [outage.start for outage in found.outages] == [300.0, 500.0]
    assert len(found.dynamics) == 2
    assert [one.start for one in found.excluded] == [405.0]
    assert found.excluded[0].reason == (
        "outage not scored: only 2 of 2 satellites could stay; 3 are needed"
    )
    # The same outages whatever number stays, where the number that is needed is stated.
    for count in (2, 1, 0):
        fewer = placed(drive, **rules, satellites=count, min_satellites=3)
        assert [outage.start for outage in fewer.outages] == [300.0, 500.0]
        assert {len(outage.satellites_visible) for outage in fewer.outages} == {count}
    assert len(placed(drive, **rules, satellites=2).outages) == 3
    with pytest.raises(LogError, match="no outage has 7 satellites that could stay: 300 s: "):
        placed(drive, **rules, satellites=7)


def test_a_silent_receiver_before_the_outage_excludes_it(
    plain: DriveLog, with_ranges: WithRanges
) -> None:
    drive = with_ranges(plain, lambda name, t: (t >= 290.0) & (t < 300.0))
    found = placed(drive, placement="listed", times=(300.0, 400.0), satellites=1)
    assert [outage.start for outage in found.outages] == [400.0]
    assert "nothing is received within 3.5 s before it" in found.excluded[0].reason


def test_receptions_that_are_missing_altogether_count_as_lost(
    plain: DriveLog, with_ranges: WithRanges
) -> None:
    # Nothing at all from 320 to 327 s: eight of 61 receptions, though none without a satellite.
    drive = with_ranges(plain, lambda name, t: (t >= 320.0) & (t <= 327.0))
    found = placed(drive, placement="listed", times=(300.0, 400.0), satellites=1)
    assert [outage.start for outage in found.outages] == [400.0]
    rules = {"placement": "listed", "times": (300.0,), "satellites": 1}
    assert len(placed(drive, **rules, min_tracked=0.88).outages) == 1


def test_listed_satellites_stay_or_the_outage_is_excluded(
    log: DriveLog, plain: DriveLog, with_ranges: WithRanges
) -> None:
    rules = {"visible": "listed", "visible_satellites": ("E05", "G02", "G04"), "satellites": 2}
    found = placed(log, **rules)
    assert {outage.satellites_visible for outage in found.outages} == {("E05", "G02")}
    drive = with_ranges(plain, lambda name, t: (t > 320.0) & (name == "G02"))
    found = placed(drive, placement="listed", times=(150.0, 300.0), **rules)
    assert [outage.start for outage in found.outages] == [150.0]
    assert "of those listed G02 could not stay" in found.excluded[0].reason


def test_a_draw_is_the_same_again_nested_and_differs_between_outages(log: DriveLog) -> None:
    def drawn(count: int, seed: int = 3) -> list[set[str]]:
        found = placed(log, satellites=count, visible="random", seed=seed, count=4)
        return [set(outage.satellites_visible) for outage in found.outages]

    three, two = drawn(3), drawn(2)
    assert three == drawn(3)
    assert all(few < more for few, more in zip(two, three, strict=True))
    assert len({frozenset(one) for one in three}) > 1
    assert three != drawn(3, seed=4)


def test_satellites_need_ranges(plain: DriveLog, with_ranges: WithRanges) -> None:
    with pytest.raises(LogError, match="the log has no raw ranges"):
        placed(plain, satellites=1)
    assert placed(plain, satellites=0).outages == placed(with_ranges(plain)).outages


def test_a_drive_without_fixes_is_placed_by_its_receptions(
    plain: DriveLog, with_ranges: WithRanges
) -> None:
    # Three satellites alone through 300 to 400 s: no position comes of them.
    drive = with_ranges(
        plain, lambda name, t: (t > 300.0) & (t < 400.0) & (name not in ("G01", "G02", "G03"))
    )
    drive = replace(drive, fixes=drive.fixes.iloc[:0])
    found = placed(drive, count=2, satellites=2, good_before=10.0, duration=40.0)
    for outage in found.outages:
        assert outage.end <= 301.0 or outage.start - 10.0 >= 399.0
    with pytest.raises(LogError, match=r"receptions of 4 satellites or more at most 3\.5 s apart"):
        placed(drive, count=9, duration=100.0)
    deaf = replace(drive, ranges=None)
    with pytest.raises(LogError, match=r"fixes at most 3\.5 s apart: 0 %"):
        placed(deaf)


def test_a_short_drive_has_short_outages(make_log: MakeLog, with_ranges: WithRanges) -> None:
    drive = with_ranges(make_log(duration=170.0, speed=6.0))
    drive = replace(drive, fixes=drive.fixes.iloc[:0])
    rules = {"warm_up": 40.0, "warm_up_moving": 20.0, "min_gap": 10.0, "good_before": 5.0}
    found = placed(drive, count=4, duration=20.0, satellites=3, **rules)
    assert [outage.start for outage in found.outages] == [40.0, 76.0, 112.0, 148.0]


def test_alone_the_lowest_tells_most_and_the_highest_least(log: DriveLog) -> None:
    def one(rule: str, elevation: float = 0.0) -> set[tuple[str, ...]]:
        found = placed(log, satellites=1, visible=rule, min_elevation=elevation)
        return {outage.satellites_visible for outage in found.outages}

    assert one("best_geometry") == {("G07",)}
    assert one("best_geometry", math.radians(15.0)) == {("E05",)}
    assert one("worst_geometry") == {("G01",)}


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"visible": "lowest"}, "visible is 'lowest'; expected one of highest, "),
        ({"satellites": -1}, "satellites is -1"),
        ({"min_satellites": -1}, "min_satellites is -1"),
        ({"visible": "listed"}, "list names"),
        ({"visible_satellites": ("G01",)}, "list names"),
        ({"visible": "listed", "visible_satellites": ("G01", "G01")}, "each once"),
        ({"visible": "listed", "visible_satellites": ("G01",), "satellites": 2}, "lists 1"),
        ({"min_tracked": 0.0}, "min_tracked is 0.0"),
        ({"min_elevation": 2.0}, "min_elevation is 2.0"),
    ],
)
def test_what_does_not_go_together_is_refused(rules: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OutageProtocol(**rules)


def test_receptions_are_counted_by_moment(log: DriveLog, sky: Directions) -> None:
    ranges = log.ranges[(log.ranges["t"] != 5.0) | (log.ranges["satellite"] == "G01")]
    found = receptions_of(ranges)
    assert found.names == tuple(sorted(sky))
    assert found.before(0.0) is None
    assert found.t[found.before(5.0)] == 4.0
    share = dict(zip(found.names, found.share(4.0, 7.0), strict=True))
    assert (share["G01"], share["G02"]) == (1.0, 0.75)
    assert 5.0 not in found.good_times()
    assert (found.share(-9.0, -1.0) == 0.0).all()
