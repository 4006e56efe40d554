"""What the tight filter refuses at its door, and what it says."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch

from navlearn.errors import ConfigError, FilterDivergedError, LogError, ShapeError
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import ClockOptions, RangeGateOptions, TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.states import FixTiming, RissSample


@pytest.fixture(scope="module")
def door(range_drive: Callable[..., Any]) -> Callable[..., Any]:
    d = range_drive(seconds=3, satellites=4)
    ekf = TightEkf(RissVehicle(d.options), systems=2)

    def run(channel: str = "", value: float = 0.0, **other: Any) -> Any:
        given = d._replace(**other)
        ranges = given.ranges
        if channel:
            spoilt = getattr(ranges, channel).clone()
            spoilt[0, 1, 2] = value
            ranges = ranges._replace(**{channel: spoilt})
        return ekf(given.start, given.samples, ranges, given.timing)

    run.drive = d  # type: ignore[attr-defined]
    return run


@pytest.mark.parametrize(
    ("channel", "value", "says"),
    [
        ("pseudorange", math.nan, r"pseudorange of drive 0 is nan at reception 1, satellite 2"),
        ("range_rate", math.inf, "finite values where it is used"),
        ("satellite", 26000.0, "convert kilometres"),
        ("satellite", math.nan, "set has_range and has_rate to 0"),
        ("satellite_velocity", 3e4, "less than 10000 m/s"),
        ("elevation", 45.0, "convert degrees with math.radians"),
        ("std_range", -1.0, "0 where the receiver tells none"),
        ("cn0", math.nan, "cn0"),
        ("system", 2, "build the filter with all its systems"),
        ("has_rate", math.nan, "has_rate"),
    ],
)
def test_ranges_that_no_receiver_measures(door: Any, channel: str, value: float, says: str) -> None:
    with pytest.raises(LogError, match=says):
        door(channel, value)


@pytest.mark.parametrize(
    ("channel", "value"), [("pseudorange", math.nan), ("satellite", 0.0), ("elevation", 45.0)]
)
def test_what_is_not_used_may_hold_anything(door: Any, channel: str, value: float) -> None:
    r = door.drive.ranges
    gone, spoilt = r.has_range.clone(), getattr(r, channel).clone()
    gone[0, 1, 2], spoilt[0, 1, 2] = 0.0, value
    ranges = r._replace(has_range=gone, has_rate=gone, **{channel: spoilt})
    assert bool(torch.isfinite(door(ranges=ranges).trajectory.lat).all())


def test_pseudoranges_in_kilometres(door: Any) -> None:
    r = door.drive.ranges
    with pytest.raises(LogError, match="convert to metres"):
        door(ranges=r._replace(pseudorange=r.pseudorange / 1000.0))


def test_shapes_and_types(door: Any) -> None:
    r, d = door.drive.ranges, door.drive
    with pytest.raises(ShapeError, match=r"ranges.range_rate has shape \(1, 3, 3\)"):
        door(ranges=r._replace(range_rate=r.range_rate[..., :3]))
    with pytest.raises(ShapeError, match="float64"):
        door(ranges=r._replace(cn0=r.cn0.float()))
    with pytest.raises(ShapeError, match="int64"):
        door(ranges=r._replace(system=r.system.double()))
    with pytest.raises(ShapeError, match="at least one satellite"):
        door(ranges=type(r)(*(x[:, :, :0] for x in r)))
    with pytest.raises(ShapeError, match="at least one sample"):
        door(samples=RissSample(*(x[:, :0] for x in d.samples)))
    start = TightEkf(RissVehicle(d.options), systems=2).start(d.start, 5)
    with pytest.raises(ShapeError, match=r"start\.refused"):
        door(start=start)
    alone = TightEkf(RissVehicle(d.options), systems=1).start(d.start, 4)
    with pytest.raises(ShapeError, match="clock_bias, clock_drift, system_offset_1"):
        door(start=alone)


def test_times_and_places(door: Any) -> None:
    d = door.drive
    with pytest.raises(LogError, match="do not decrease"):
        door(timing=FixTiming(d.timing.index.flip(1), d.timing.delay))
    with pytest.raises(LogError, match="delay"):
        door(timing=d.timing._replace(delay=d.timing.delay + 60.0))
    state = d.start.state
    with pytest.raises(LogError, match="radians"):
        door(start=d.start._replace(state=state._replace(lat=state.lat + 44.0)))
    with pytest.raises(FilterDivergedError):
        door(start=d.start._replace(covariance=0.0 * d.start.covariance))


def test_options() -> None:
    with pytest.raises(ConfigError, match=r"math\.radians"):
        TightEkfOptions(elevation_mask=10.0)
    with pytest.raises(ConfigError, match="least_cn0"):
        TightEkfOptions(least_cn0=math.nan)
    with pytest.raises(ConfigError, match="frequency_walk"):
        ClockOptions(frequency_walk=-1.0)
    with pytest.raises(ConfigError, match="initial_bias"):
        ClockOptions(initial_bias=0.0)
    with pytest.raises(ConfigError, match="probability"):
        RangeGateOptions(probability=1.5)
    with pytest.raises(ConfigError, match="fewer ranges do not tell"):
        RangeGateOptions(least_satellites=3)


def test_methods_and_systems(door: Any) -> None:
    d = door.drive
    with pytest.raises(ConfigError, match="exact"):
        TightEkf(RissVehicle(d.options), systems=2)(
            d.start, d.samples, d.ranges, d.timing, method="quick"
        )
    with pytest.raises(ConfigError, match="systems"):
        TightEkf(RissVehicle(d.options), systems=0)


def test_long_stretches_are_no_single_block(door: Any) -> None:
    d = door.drive
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    with pytest.raises(ShapeError, match="give shorter stretches"):
        ekf.step(ekf.start(d.start, 4), d.samples)


def test_a_filter_that_refuses_most_says_so(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=20, seed=2)
    tiny = RangeNoiseOptions(
        orbit_clock=1e-3, ionosphere=0.0, troposphere=0.0, multipath=0.0, thermal=1e-3
    )
    gate = RangeGateOptions(reset_after=1000)
    ekf = TightEkf(RissVehicle(d.options), TightEkfOptions(range_noise=tiny, gate=gate), systems=2)
    with pytest.warns(UserWarning, match="refused more than 50% of the pseudoranges"):
        ekf(d.start, d.samples, d.ranges, d.timing)
