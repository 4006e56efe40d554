"""What methods are handed of the ranges of a partial outage, and what they are not."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.known_log import known_log
from navlearn.outages.replay import Replay, Solution, replay
from navlearn.outages.schedule import Outage

MakeLog = Callable[..., DriveLog]
WithRanges = Callable[..., DriveLog]
Directions = Mapping[str, tuple[float, float]]


@pytest.fixture(scope="module")
def log(make_log: MakeLog, with_ranges: WithRanges) -> DriveLog:
    return with_ranges(make_log(duration=600.0, azimuth=lambda t: 0.5 + 0.3 * np.sin(t / 20.0)))


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
