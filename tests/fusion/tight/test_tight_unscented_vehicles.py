"""The tight filter by sigma points with either vehicle: beside the loose one, and navigating."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.attitude import quaternion_from_angles
from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.states import FixTiming, GnssFix, InsState, SatelliteRanges
from navlearn.tight_navigator import TightNavigator, TightNavigatorOptions


def nothing(shape: tuple[int, ...], satellites: int = 3) -> SatelliteRanges:
    nan = torch.full((*shape, satellites), torch.nan, dtype=torch.float64)
    vector = nan.unsqueeze(-1).expand(*nan.shape, 3)
    none, system = torch.zeros_like(nan), torch.zeros(nan.shape, dtype=torch.int64)
    return SatelliteRanges(vector, vector, nan, nan, nan, nan, nan, nan, system, none, none)


def no_fixes(timing: FixTiming) -> GnssFix:
    return GnssFix(*(torch.zeros_like(timing.delay) for _ in GnssFix._fields))


def pointed(options: Any, alpha: float = 0.5) -> Any:
    return replace(options, unscented=UnscentedOptions(alpha=alpha))


def assert_same(found: Any, wanted: Any, **tolerance: float) -> None:
    if isinstance(found, Tensor):
        torch.testing.assert_close(found, wanted, equal_nan=True, **tolerance)
    elif isinstance(found, tuple):
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other, **tolerance)


def metres(one: TightHistory, other: TightHistory, first: int = 0) -> float:
    way = torch.stack(enu_between(*one.trajectory[:3], *other.trajectory[:3]))
    return float(way[..., first:].norm(dim=0).max())


@pytest.mark.parametrize(
    "options", [EkfOptions(), EkfOptions(lever_arm=(0.5, 1.0, 1.2), speed_terms=("scale",))]
)
@pytest.mark.parametrize("method", ["exact", "sequential"])
def test_without_satellites_riss_is_the_loosely_coupled_filter(
    make_drive: Callable[..., Any],
    model_start: Callable[..., Any],
    options: EkfOptions,
    method: str,
) -> None:
    d = make_drive(seconds=12, batch=2)
    options = pointed(options)
    start = model_start(options, d.start)
    with torch.no_grad():
        loose = LooselyCoupledUkf(options)(
            start, d.samples, no_fixes(d.timing), d.timing, method=method
        )
        ekf = TightEkf(RissVehicle(options), systems=2)
        tight = ekf(start, d.samples, nothing((2, 12)), d.timing, method=method)
    assert_same(tight.trajectory, loose.trajectory, atol=1e-11, rtol=1e-12)
    assert_same(tight.belief.vehicle, loose.belief, atol=1e-8, rtol=1e-8)
    assert torch.equal(tight.own_verdict, loose.verdict)
    assert bool((tight.verdict == Verdict.ABSENT).all())


@lru_cache(maxsize=1)
def imu_drive() -> Any:
    log = simulate_drive(
        profile="town",
        grade="mems_m",
        duration=60.0,
        seed=12,
        imu_rate_hz=50.0,
        standstill=10.0,
        satellites=SatelliteOptions(systems=("G", "E")),
    ).log
    return log, imu_timeline(log)


def test_without_satellites_a_full_imu_is_the_loosely_coupled_filter() -> None:
    log, line = imu_drive()
    first = log.reference.iloc[0]
    vector = lambda *names: torch.tensor([float(first[n]) for n in names]).double()  # noqa: E731
    attitude = quaternion_from_angles(*vector("azimuth", "pitch", "roll").unbind())
    place = vector("lat", "lon", "height").unbind()
    options = pointed(InsEkfOptions())
    start = initial_ins_belief(options, InsState(*place, vector("v_e", "v_n", "v_u"), attitude))
    samples = type(line.samples)(*(x[:1000] for x in line.samples))
    keep = line.timing.index < 1000
    timing = FixTiming(*(x[keep] for x in line.timing))
    with torch.no_grad():
        loose = InsUkf(options)(start, samples, no_fixes(timing), timing)
        ekf = TightEkf(InsVehicle(options))
        tight = ekf(start, samples, nothing(tuple(timing.index.shape)), timing)
    assert_same(tight.trajectory, loose.trajectory, atol=1e-8, rtol=1e-11)
    assert_same(tight.belief.vehicle, loose.belief, atol=1e-7, rtol=1e-6)
    assert torch.equal(tight.own_verdict, loose.verdict)


@pytest.mark.parametrize("vehicle", [EkfOptions(), InsEkfOptions()])
def test_the_navigator_runs_it(vehicle: Any) -> None:
    log, line = imu_drive()
    if isinstance(vehicle, EkfOptions):
        line = riss_timeline(log, rate_hz=50.0, dims=3)
    edges = [line.start_time, *line.t.tolist()]
    series = ranges_of(log, torch.tensor(edges).double().numpy(), RangeOptions())
    found = []
    for options in (vehicle, pointed(vehicle)):
        navigator = TightNavigator(TightNavigatorOptions(vehicle=options))
        found.append(
            navigator.run(line.samples, line.fixes, line.timing, series.ranges, series.timing)
        )
    linear, points = (one.history for one in found)
    assert (linear.method, points.method) == ("fast", "exact")
    assert metres(points, linear) < 2.0
    assert float((points.verdict == Verdict.ACCEPTED).sum()) > 0.9 * float(
        (linear.verdict == Verdict.ACCEPTED).sum()
    )
