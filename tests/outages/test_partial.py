"""Partial outages: the satellites that stay, by rule, and what methods are handed of them."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.placement import place_outages
from navlearn.outages.receptions import receptions_of
from navlearn.outages.replay import Replay, Solution, replay
from navlearn.outages.schedule import Outage, OutageProtocol, Placement
from navlearn.outages.sky import sky_at
from navlearn.outages.track import track_of
from navlearn.outages.visible import PRIOR, RANGE, chosen, information

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


units = st.tuples(st.floats(5.0, 89.0), st.floats(0.0, 359.0)).map(lambda sky: direction(*sky))


@settings(max_examples=60, deadline=None)
@given(st.lists(units, min_size=1, max_size=6).map(np.array))
def test_information_is_that_of_a_weighted_least_squares(unit: np.ndarray) -> None:
    # The second way: the inverse of the plane's block of the covariance of the whole.
    rows = np.concatenate((-unit, np.ones((len(unit), 1))), axis=1)
    normal = rows.T @ rows / RANGE**2 + np.diag(np.array(PRIOR) ** -2.0)
    plane = np.linalg.inv(normal)[:2, :2]
    assert information(unit) == pytest.approx(1.0 / np.linalg.det(plane), rel=1e-8)
    # More ranges never tell less, and turning the sky changes nothing.
    assert information(unit) >= information(unit[:-1]) * (1.0 - 1e-9)
    c, s = math.cos(0.7), math.sin(0.7)
    turned = unit @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert information(turned) == pytest.approx(information(unit), rel=1e-8)


def test_alone_the_lowest_tells_most_and_the_highest_least(log: DriveLog) -> None:
    def one(rule: str, elevation: float = 0.0) -> set[tuple[str, ...]]:
        found = placed(log, satellites=1, visible=rule, min_elevation=elevation)
        return {outage.satellites_visible for outage in found.outages}

    assert one("best_geometry") == {("G07",)}
    assert one("best_geometry", math.radians(15.0)) == {("E05",)}
    assert one("worst_geometry") == {("G01",)}


@settings(max_examples=25, deadline=None)
@given(st.lists(units, min_size=3, max_size=8).map(np.array), st.integers(1, 3))
def test_no_choice_tells_more_than_the_best_or_less_than_the_worst(
    unit: np.ndarray, count: int
) -> None:
    names = [f"G{k:02d}" for k in range(len(unit))]
    told = {
        tuple(names[k] for k in members): information(unit[list(members)])
        for members in combinations(range(len(unit)), count)
    }
    best = chosen("best_geometry", count, names, unit)
    worst = chosen("worst_geometry", count, names, unit)
    assert told[best] == max(told.values())
    assert told[worst] == min(told.values())


def test_of_very_many_satellites_they_are_taken_one_after_another() -> None:
    rng = np.random.default_rng(0)
    sky = zip(rng.uniform(10.0, 85.0, 40), rng.uniform(0.0, 360.0, 40), strict=True)
    unit = np.array([direction(e, a) for e, a in sky])
    names = [f"G{k:02d}" for k in range(40)]
    found = chosen("best_geometry", 5, names, unit)  # 658 008 subsets
    taken = information(unit[[names.index(name) for name in found]])
    some = [information(unit[rng.permutation(40)[:5]]) for _ in range(2000)]
    assert len(set(found)) == 5
    assert taken > max(some)


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


@dataclass
class Ranger:
    """A method whose answer holds every range and fix that it was given."""

    sees_after: float = 0.0
    seen: list[DriveLog] = field(default_factory=list)

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        self.seen.append(log)
        numbers = log.ranges.drop(columns="satellite").to_numpy(dtype=float)
        told = 1e-16 * float(numbers.sum()) + 1e-12 * float(log.fixes["lat"].sum())
        t = np.arange(outage.start, outage.end + 0.5, 1.0)
        table = pd.DataFrame({"t": t, "lat": 0.7 + told, "lon": -1.3, "height": 100.0})
        return Solution(table=table.assign(v_e=0.0, v_n=0.0, azimuth=0.0))


OUTAGES = (Outage(200.0, 60.0, ("G02", "R06")), Outage(300.0, 60.0), Outage(400.0, 60.0, ("G03",)))


def test_a_method_is_handed_exactly_the_satellites_that_stay(log: DriveLog) -> None:
    method = Ranger()
    found = replay(log, OUTAGES, {"ranger": method}, progress=False)
    for outage, known in zip(OUTAGES, method.seen, strict=True):
        before = known.ranges[known.ranges["t"] < outage.start]
        through = known.ranges[known.ranges["t"] >= outage.start]
        pd.testing.assert_frame_equal(before, log.ranges[log.ranges["t"] < outage.start])
        assert set(through["satellite"]) == set(outage.satellites_visible)
        assert known.fixes["t"].max() < outage.start
        if outage.satellites_visible:
            assert through["t"].max() == outage.end
            assert (through.groupby("t").size() == len(outage.satellites_visible)).all()
        # Nothing tells how many satellites would have gone on being received.
        assert known.reference is None
        assert known.metadata.extra == {}
    assert found.rows["satellites"].tolist() == [2, 0, 1]
    assert found.rows["satellites_visible"].tolist() == ["G02 R06", "", "G03"]


def spoilt(log: DriveLog, outage: Outage) -> DriveLog:
    """Return the log with all that a method must not see of an outage made absurd."""
    ranges = log.ranges.copy()
    inside = (ranges["t"] >= outage.start) & (ranges["t"] <= outage.end)
    gone = inside & ~ranges["satellite"].isin(outage.satellites_visible)
    gone |= ranges["t"] > outage.end
    numbers = [name for name in ranges.columns if name not in ("t", "satellite")]
    ranges.loc[gone, numbers] = 1e9
    # A satellite that nobody has ever received, from the outage's start on.
    alien = ranges[inside & (ranges["satellite"] == "G01")].assign(satellite="C60")
    ranges = pd.concat([ranges, alien]).sort_values(["t", "satellite"], ignore_index=True)
    fixes = log.fixes.copy()
    fixes.loc[fixes["t"] >= outage.start, ["lat", "lon"]] = 0.0
    return replace(log, ranges=ranges, fixes=fixes)


@pytest.mark.parametrize("outage", OUTAGES)
def test_ranges_withheld_move_no_output_and_those_that_stay_do(
    log: DriveLog, outage: Outage, tmp_path: Path
) -> None:
    def run(drive: DriveLog, folder: str) -> Replay:
        return replay(
            drive, [outage], {"ranger": Ranger()}, progress=False,
            store=tmp_path / folder, settings={"ranger": {}},
        )  # fmt: skip

    clean = run(log, "clean").solutions["ranger", 1].table
    pd.testing.assert_frame_equal(run(spoilt(log, outage), "b").solutions["ranger", 1].table, clean)
    for name in outage.satellites_visible:
        ranges = log.ranges.copy()
        late = (ranges["satellite"] == name) & (ranges["t"] == outage.end)
        ranges.loc[late, "pseudorange"] += 1e6
        moved = run(replace(log, ranges=ranges), name).solutions["ranger", 1].table
        assert (moved["lat"] != clean["lat"]).all()


def test_post_processing_sees_ranges_after_the_outage_and_only_some_within(
    log: DriveLog, sky: Directions
) -> None:
    outage = OUTAGES[0]
    known = known_log(log, outage, after=20.0)
    t, name = known.ranges["t"], known.ranges["satellite"]
    inside = (t >= outage.start) & (t < outage.end)
    assert set(name[inside]) == {"G02", "R06"}
    assert set(name[(t >= outage.end) & (t <= 280.0)]) == set(sky)
    assert t.max() == 280.0


def test_another_choice_of_satellites_is_another_stored_solution(
    log: DriveLog, tmp_path: Path
) -> None:
    method = Ranger()
    for visible in (("G01",), ("G02",), ("G01",)):
        replay(
            log, [Outage(200.0, 60.0, visible)], {"ranger": method}, progress=False,
            store=tmp_path, settings={"ranger": {}},
        )  # fmt: skip
    assert len(method.seen) == 2


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
