from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from navlearn.errors import ConfigError, LogError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.dynamics import classify_outage
from navlearn.outages.placement import place_outages
from navlearn.outages.schedule import OutageProtocol, Placement
from navlearn.outages.track import track_of

MakeLog = Callable[..., DriveLog]


def gaps_between(placed: Placement) -> np.ndarray:
    starts = np.array([outage.start for outage in placed.outages])
    ends = np.array([outage.end for outage in placed.outages])
    return starts[1:] - ends[:-1]


@settings(deadline=None, max_examples=30)
@given(
    placement=st.sampled_from(["spread", "random", "by_dynamics"]),
    count=st.integers(1, 12),
    duration=st.floats(5.0, 120.0),
    min_gap=st.floats(0.0, 60.0),
    hole=st.tuples(st.floats(0.0, 850.0), st.floats(0.0, 200.0)),
    seed=st.integers(0, 3),
)
def test_outages_never_overlap_lie_inside_and_number_as_asked(
    straight_log: DriveLog,
    placement: str,
    count: int,
    duration: float,
    min_gap: float,
    hole: tuple[float, float],
    seed: int,
) -> None:
    fixes = straight_log.fixes
    inside = (fixes["t"] > hole[0]) & (fixes["t"] < hole[0] + hole[1])
    log = replace(straight_log, fixes=fixes[~inside])
    protocol = OutageProtocol(
        placement=placement,
        count=count,
        duration=duration,
        min_gap=min_gap,
        warm_up=100.0,
        seed=seed,
        good_before=10.0,
    )
    try:
        placed = place_outages(protocol, log)
    except LogError as error:
        event(str(error).split(": ")[0])
        return
    assert len(placed.outages) == len(placed.dynamics) == count
    assert (gaps_between(placed) >= min_gap - 1e-6).all()
    assert placed.outages[0].start >= 100.0
    assert placed.outages[-1].end <= 900.0
    if hole[1] > protocol.max_fix_interval + 2.0:
        for outage in placed.outages:
            assert outage.end <= hole[0] + 1.0 or outage.start >= hole[0] + hole[1] - 1.0


def test_spread_begins_after_the_warm_up_and_is_even(straight_log: DriveLog) -> None:
    placed = place_outages(OutageProtocol(count=5, duration=60.0), straight_log)
    starts = [outage.start for outage in placed.outages]
    assert starts == [300.0, 435.0, 570.0, 705.0, 840.0]  # (900 − 60 − 300) / 4 = 135
    assert placed.dynamics == ("straight",) * 5
    assert placed.excluded == ()


def test_too_many_outages_say_how_many_fit(straight_log: DriveLog) -> None:
    # Starts 300 to 840 s, 90 s apart: 300, 390, ... 840 are seven.
    with pytest.raises(LogError, match=r"made: 8 outages of 60 s were asked for, 7 fit"):
        place_outages(OutageProtocol(count=8), straight_log)
    assert len(place_outages(OutageProtocol(count=7), straight_log).outages) == 7


@pytest.mark.parametrize("placement", ["random", "by_dynamics"])
def test_every_placement_says_how_many_fit(straight_log: DriveLog, placement: str) -> None:
    with pytest.raises(LogError, match=r"fit between 0 and 900 s.*Share of starts"):
        place_outages(OutageProtocol(placement=placement, count=30), straight_log)


def test_a_parked_car_is_not_scored(make_log: MakeLog) -> None:
    log = make_log(duration=900.0, speed=lambda t: np.where((t > 400) & (t < 700), 0.0, 10.0))
    placed = place_outages(OutageProtocol(count=3, min_mean_speed=5.0), log)
    for outage in placed.outages:
        # 5 m/s of 10 m/s halved for stops: at least a quarter of the 60 s is driven.
        assert outage.end <= 400.0 + 45.5 or outage.start >= 700.0 - 45.5


def test_a_car_that_has_not_moved_yet_is_not_scored(make_log: MakeLog) -> None:
    log = make_log(duration=900.0, speed=lambda t: np.where(t < 500.0, 0.0, 10.0))
    placed = place_outages(OutageProtocol(count=2, warm_up_moving=60.0), log)
    assert 560.0 <= placed.outages[0].start <= 561.5


def test_listed_outages_are_taken_as_they_are(straight_log: DriveLog) -> None:
    protocol = OutageProtocol(placement="listed", times=(500.0, 100.0), duration=30.0)
    placed = place_outages(protocol, straight_log)
    assert [(outage.start, outage.duration) for outage in placed.outages] == [(100, 30), (500, 30)]


def test_listed_outages_outside_the_log_are_refused(straight_log: DriveLog) -> None:
    protocol = OutageProtocol(placement="listed", times=(880.0,), duration=30.0)
    with pytest.raises(LogError, match=r"from 880 to 910 s lies outside the log.*from 0 to 900 s"):
        place_outages(protocol, straight_log)


def test_listed_outages_that_overlap_are_refused(straight_log: DriveLog) -> None:
    protocol = OutageProtocol(placement="listed", times=(100.0, 120.0), duration=30.0)
    with pytest.raises(ConfigError, match="overlaps"):
        place_outages(protocol, straight_log)


def slid(log: DriveLog, start: float, end: float, metres: float) -> DriveLog:
    """Let the reference slide north between two times against its own velocity."""
    assert log.reference is not None
    share = np.clip((log.reference["t"] - start) / (end - start), 0.0, 1.0)
    return replace(
        log, reference=log.reference.assign(lat=log.reference["lat"] + share * metres / 6_371e3)
    )


def test_a_reference_that_slides_is_excluded_and_listed(straight_log: DriveLog) -> None:
    log = slid(straight_log, 480.0, 520.0, 30.0)
    protocol = OutageProtocol(placement="listed", times=(470.0, 600.0), duration=30.0)
    placed = place_outages(protocol, log)
    assert [outage.start for outage in placed.outages] == [600.0]
    slide, outage = placed.excluded
    # 30 m in 40 s is 7.5 m in 10 s; spans that hold 6.7 s of it or more break the 5 m limit.
    assert "slides 7.5 m" in slide.reason
    assert slide.start == pytest.approx(480.0 - 10.0 + 6.7, abs=0.3)
    assert slide.end == pytest.approx(520.0 + 10.0 - 6.7, abs=0.3)
    assert outage.reason.startswith("outage not scored")
    spread = place_outages(OutageProtocol(count=4), log)
    assert all(o.end <= slide.start or o.start >= slide.end for o in spread.outages)


def test_a_slow_slide_below_the_limit_is_kept(straight_log: DriveLog) -> None:
    placed = place_outages(OutageProtocol(count=4), slid(straight_log, 400.0, 800.0, 30.0))
    assert placed.excluded == ()


def test_a_hole_in_the_reference_is_excluded(straight_log: DriveLog) -> None:
    assert straight_log.reference is not None
    table = straight_log.reference
    log = replace(straight_log, reference=table[(table["t"] < 500.0) | (table["t"] > 510.0)])
    placed = place_outages(OutageProtocol(count=4), log)
    assert [one.reason for one in placed.excluded] == ["no truth for 10.2 s"]
    assert all(outage.end <= 500.0 or outage.start >= 510.0 for outage in placed.outages)


def test_a_log_without_reference_is_judged_by_its_fixes(straight_log: DriveLog) -> None:
    placed = place_outages(OutageProtocol(count=3), replace(straight_log, reference=None))
    assert len(placed.outages) == 3
    assert any("judged by its own GNSS fixes" in note for note in placed.notes)
    assert any("course" in note for note in placed.notes)


def test_a_log_without_any_position_is_refused(straight_log: DriveLog) -> None:
    log = replace(straight_log, reference=None, fixes=straight_log.fixes.iloc[:0])
    with pytest.raises(LogError, match="0 usable positions"):
        place_outages(OutageProtocol(), log)


def test_dynamics_are_told_and_can_be_asked_for(make_log: MakeLog) -> None:
    def speed(t: np.ndarray) -> np.ndarray:
        return np.select([t < 600.0, t < 900.0], [10.0, 28.0], np.where(t < 1020.0, 0.0, 10.0))

    def azimuth(t: np.ndarray) -> np.ndarray:
        return np.clip((t - 480.0) / 20.0, 0.0, np.pi / 2.0)

    log = make_log(duration=1300.0, speed=speed, azimuth=azimuth)
    protocol = OutageProtocol(placement="by_dynamics", count=8, duration=40.0, warm_up=100.0)
    placed = place_outages(protocol, log)
    assert set(placed.dynamics) == {"straight", "turn", "motorway", "stop"}
    assert "no hill outage: the drive has no such stretch" in placed.notes
    track = track_of(log)
    for outage, word in zip(placed.outages, placed.dynamics, strict=True):
        assert classify_outage(track, outage) == word
        if word == "motorway":
            assert outage.start >= 600.0 - 40.0 * (28.0 - 22.0) / 18.0
            assert outage.end <= 900.0 + 40.0 * (28.0 - 22.0) / 28.0
        if word == "turn":
            assert outage.start < 512.0
            assert outage.end > 480.0


def test_a_hill_is_a_span_of_heights(make_log: MakeLog) -> None:
    log = make_log(duration=600.0)
    assert log.reference is not None
    climb = 100.0 + 0.04 * 10.0 * np.clip(log.reference["t"] - 300.0, 0.0, 100.0)
    log = replace(log, reference=log.reference.assign(height=climb))
    protocol = OutageProtocol(placement="listed", times=(200.0, 320.0), duration=60.0)
    assert place_outages(protocol, log).dynamics == ("straight", "hill")
