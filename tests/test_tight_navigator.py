"""The tightly coupled navigator on simulated drives."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.errors import ConfigError, LogError
from navlearn.frames import enu_between
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.start import told_from
from navlearn.fusion.tight.history import TightHistory
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.imu_timeline import ImuTimeline, imu_timeline
from navlearn.logs.range_tensors import RangeSeries, ranges_of
from navlearn.logs.resample import RissTimeline, riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.mechanization.alignment import AlignmentOptions
from navlearn.mechanization.ins_alignment import InsAlignmentOptions
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.states import FixTiming, GnssFix, SatelliteRanges
from navlearn.tight_navigator import (
    TightNavigator,
    TightNavigatorOptions,
    TightNavigatorRun,
    tight_belief_at,
)


class Case(NamedTuple):
    """A drive of either kind of car, its ranges, and what a filter of it is asked for."""

    line: RissTimeline | ImuTimeline
    series: RangeSeries
    vehicle: EkfOptions | InsEkfOptions


@lru_cache(maxsize=1)
def log() -> DriveLog:
    satellites = SatelliteOptions(systems=("G", "E"))
    return simulate_drive(
        profile="town",
        grade="mems_m",
        duration=150.0,
        seed=12,
        imu_rate_hz=20.0,
        satellites=satellites,
    ).log


@lru_cache(maxsize=4)
def case(kind: str) -> Case:
    line: RissTimeline | ImuTimeline
    vehicle: EkfOptions | InsEkfOptions = EkfOptions()
    if kind == "riss":
        line = riss_timeline(log(), rate_hz=10.0, dims=3)
    else:
        line, vehicle = imu_timeline(log()), InsEkfOptions(states=int(kind))
    edges = np.concatenate(([line.start_time], line.t.numpy()))
    return Case(line, ranges_of(log(), edges), vehicle)


@lru_cache(maxsize=4)
def ran(kind: str) -> tuple[TightNavigator, TightNavigatorRun]:
    line, series, vehicle = case(kind)
    navigator = TightNavigator(TightNavigatorOptions(vehicle=vehicle))
    job = (line.samples, line.fixes, line.timing, series.ranges, series.timing)
    return navigator, navigator.run(*job, systems=len(series.systems))


def in_turn(kind: str) -> TightNavigator:
    return TightNavigator(TightNavigatorOptions(vehicle=case(kind).vehicle, method="exact"))


def horizontal(run: TightNavigatorRun, t: Tensor) -> Tensor:
    truth = log().reference
    assert truth is not None
    path = run.history.trajectory
    known = [np.interp(t[run.first :], truth["t"], truth[name]) for name in ("lat", "lon")]
    lat, lon = (torch.from_numpy(x) for x in known)
    east, north, _ = enu_between(path.lat, path.lon, path.height, lat, lon, path.height)
    return torch.hypot(east, north)


@pytest.mark.parametrize("kind", ["riss", "9", "15"])
def test_it_starts_itself_and_follows_the_car(kind: str) -> None:
    it = case(kind)
    _, run = ran(kind)
    assert run.history.method == "fast"
    assert run.first == run.alignment.sample + 1
    assert run.samples.dt.shape[-1] == it.line.t.shape[-1] - run.first
    assert run.history.trajectory.lat.shape == run.samples.dt.shape
    error = horizontal(run, it.line.t)
    assert float(error[300:].median()) < 3.0
    assert float(error[300:].max()) < 8.0
    # both systems are used, and their clocks are told apart
    assert run.history.belief.clock.shape[-1] == 3
    assert float(run.history.belief.covariance[-1, -1, -1].sqrt()) < 5.0


def test_the_loosely_coupled_navigator_aligns_alike() -> None:
    it = case("riss")
    navigator, run = ran("riss")
    loose = Navigator(NavigatorOptions(filter=EkfOptions()))
    expected = loose.run(it.line.samples, it.line.fixes, it.line.timing)
    assert run.first == expected.first
    ours, theirs = navigator.start(run.alignment), loose.start(expected.alignment)
    for a, b in zip(ours.state, theirs.state, strict=True):
        assert torch.equal(a, b)
    assert torch.equal(ours.covariance, theirs.covariance)


@pytest.mark.parametrize("kind", ["riss", "15", "9"])
def test_without_satellites_it_is_the_loosely_coupled_filter(kind: str) -> None:
    """From one belief on, with none left, both predict, stand still and listen to wheels alike."""
    it = case(kind)
    navigator, run = in_turn(kind), ran(kind)[1]
    block = int(torch.nonzero(run.history.reception >= 0)[-25])
    gone = int(run.history.end[block]) + 1
    samples: Any = type(run.samples)(*(channel[gone:] for channel in run.samples))
    belief = tight_belief_at(run.history, block)
    ranges, timing = told_from(it.series.ranges, it.series.timing, 10**9)
    assert ranges.has_range.shape[0] == 0
    ours = navigator.filter_on(belief, samples, ranges, timing)
    theirs: Any
    if kind == "riss":
        plain = Navigator(NavigatorOptions(filter=EkfOptions(), method="exact"))
        theirs = plain.filter_on(belief.vehicle, samples, torch.zeros_like(samples.dt))
    else:
        options = InsNavigatorOptions(filter=it.vehicle, method="exact")  # type: ignore[arg-type]
        theirs = InsNavigator(options).filter_on(belief.vehicle, samples)
    assert samples.dt.shape[-1] > 200
    n = theirs.belief.covariance.shape[-1]
    own, other = ours.belief.covariance[..., :n, :n], theirs.belief.covariance
    torch.testing.assert_close(own, other, rtol=1e-9, atol=1e-15)
    for a, b in zip(ours.trajectory, theirs.trajectory, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=1e-11)
    assert torch.equal(ours.own_verdict, theirs.verdict)


def visible(ranges: SatelliteRanges, count: int) -> SatelliteRanges:
    """The ranges of the first few satellites of the first system alone."""
    slots = torch.zeros_like(ranges.has_range)
    slots[:, :count] = 1.0
    return ranges._replace(has_range=ranges.has_range * slots, has_rate=ranges.has_rate * slots)


def test_every_satellite_that_is_left_helps() -> None:
    it = case("riss")
    navigator, run = ran("riss")
    block = int(torch.nonzero(run.history.reception >= 0)[-60])
    gone = int(run.history.end[block]) + 1
    samples: Any = type(run.samples)(*(channel[gone:] for channel in run.samples))
    belief = tight_belief_at(run.history, block)
    later = told_from(it.series.ranges, it.series.timing, run.first + gone)
    sigma = []
    for count in (0, 2, 3, 6):
        history = navigator.filter_on(belief, samples, visible(later[0], count), later[1])
        sigma.append(float(history.belief.covariance[-1, :2, :2].trace().sqrt()))
    assert sigma == sorted(sigma, reverse=True)
    assert sigma[0] > 1.5 * sigma[-1], sigma


def test_filtering_on_from_a_belief_is_the_run_itself() -> None:
    it = case("riss")
    navigator, run = ran("riss")
    block = int(torch.nonzero(run.history.reception >= 0)[-60])
    gone = int(run.history.end[block]) + 1
    samples: Any = type(run.samples)(*(channel[gone:] for channel in run.samples))
    later = told_from(it.series.ranges, it.series.timing, run.first + gone)
    again: TightHistory = navigator.filter_on(tight_belief_at(run.history, block), samples, *later)
    torch.testing.assert_close(
        again.trajectory.lat, run.history.trajectory.lat[gone:], rtol=0.0, atol=1e-11
    )
    torch.testing.assert_close(
        again.belief.clock, run.history.belief.clock[block + 1 :], rtol=0.0, atol=1e-4
    )


def test_it_says_when_the_car_never_drove() -> None:
    it = case("riss")
    kept = it.line.fix_time < 20.0
    fixes = GnssFix(*(channel[kept] for channel in it.line.fixes))
    timing = FixTiming(*(channel[kept] for channel in it.line.timing))
    navigator = TightNavigator(TightNavigatorOptions())
    with pytest.raises(LogError, match="alignment"):
        navigator.run(it.line.samples, fixes, timing, it.series.ranges, it.series.timing)


def test_cars_are_not_mixed_up() -> None:
    with pytest.raises(ConfigError, match="InsAlignmentOptions"):
        TightNavigatorOptions(alignment=InsAlignmentOptions())
    with pytest.raises(ConfigError, match="AlignmentOptions"):
        TightNavigatorOptions(vehicle=InsEkfOptions(), alignment=AlignmentOptions())
    it = case("15")
    navigator = TightNavigator()
    with pytest.raises(ConfigError, match="ImuSample"):
        navigator.align(it.line.samples, it.line.fixes, it.line.timing)
    with pytest.raises(ConfigError, match="alignment"):
        TightNavigator(TightNavigatorOptions(vehicle=InsEkfOptions())).start(
            ran("riss")[1].alignment
        )


def test_one_filter_serves_all_runs() -> None:
    navigator = TightNavigator()
    assert navigator.filter(2) is navigator.filter(2)
    assert navigator.filter(1).vehicle is navigator.filter(2).vehicle
