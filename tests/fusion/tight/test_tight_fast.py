"""The tight filter with all blocks at once against the loop: states, verdicts, gradients."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree
from navlearn.frames import enu_between
from navlearn.fusion import convergence
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.packing import packed_reception
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.fusion.tight.timeline import Reception
from navlearn.ins_navigator import InsNavigator, InsNavigatorOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.range_tensors import ranges_of
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, ImuSample, RissSample, SatelliteRanges

JUMP = 299792.458
"""A millisecond, as receivers set their clocks by, m."""


def plain(ranges: SatelliteRanges) -> SatelliteRanges:
    return ranges


def wild(ranges: SatelliteRanges) -> SatelliteRanges:
    """One satellite far off for a while, another noisy, a rate off."""
    g = torch.Generator().manual_seed(3)
    far, rate = ranges.pseudorange.clone(), ranges.range_rate.clone()
    far[..., 10:25, 1] += 500.0
    far[..., 20:, 3] += 60.0 * torch.randn(far[..., 20:, 3].shape, generator=g).double()
    rate[..., 30, 2] += 5.0
    return ranges._replace(pseudorange=far, range_rate=rate)


def jumping(ranges: SatelliteRanges) -> SatelliteRanges:
    far = ranges.pseudorange.clone()
    far[..., 15:, :] += JUMP
    far[..., 28:, :] -= 2.0 * JUMP
    return ranges._replace(pseudorange=far)


def few(ranges: SatelliteRanges) -> SatelliteRanges:
    """Two satellites from the tenth reception on, then one, then none, then all."""
    has = ranges.has_range.clone()
    for first, last, left in ((10, 18, 2), (18, 24, 1), (24, 30, 0)):
        has[..., first:last, left:] = 0.0
    return ranges._replace(has_range=has, has_rate=has * ranges.has_rate)


def drifted(ranges: SatelliteRanges) -> SatelliteRanges:
    """All satellites agree that the car is elsewhere: position begins anew after some patience."""
    moved = ranges.satellite.clone()
    moved[..., 10:, :, :] += torch.tensor([300.0, -200.0, 100.0], dtype=torch.float64)
    return ranges._replace(satellite=moved)


SITUATIONS = {"plain": plain, "wild": wild, "jump": jumping, "few": few, "drifted": drifted}
MODELS = {
    "bias_scale": EkfOptions(),
    "plane": EkfOptions(mechanization=RissOptions(dimensions=2), lever_arm=(0.5, 1.0, 1.2)),
    "shen2010_full": EkfOptions(model="shen2010_full"),
}


def assert_equal(fast: TightHistory, exact: TightHistory, metres: float) -> None:
    """Positions to ``metres``, everything that is judged to the last."""
    assert (fast.method, exact.method) == ("fast", "exact")
    for name in ("verdict", "own_verdict", "resets", "end", "reception"):
        assert torch.equal(getattr(fast, name), getattr(exact, name)), name
    assert torch.equal(fast.belief.refused, exact.belief.refused)
    assert torch.equal(fast.prior.refused, exact.prior.refused)
    assert torch.equal(fast.belief.vehicle.refused, exact.belief.vehicle.refused)
    way = enu_between(*fast.trajectory[:3], *exact.trajectory[:3])
    assert float(torch.stack(way).detach().abs().max()) < metres
    close = torch.testing.assert_close
    close(fast.belief.clock, exact.belief.clock, atol=metres, rtol=0.0)
    sigma = exact.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    scale = sigma.unsqueeze(-1) * sigma.unsqueeze(-2)
    gap = (fast.belief.covariance - exact.belief.covariance) / scale
    assert float(gap.detach().abs().max()) < 2e-3
    for name in ("innovation", "rate_innovation", "residual"):
        found, wanted = getattr(fast, name), getattr(exact, name)
        close(found, wanted, atol=3.0 * metres, rtol=1e-8, equal_nan=True, msg=name)
    for name in ("nis", "own_nis", "spread"):
        found, wanted = getattr(fast, name), getattr(exact, name)
        close(found, wanted, atol=2e-3, rtol=2e-3, equal_nan=True, msg=name)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_riss_fast_is_exact(range_drive: Callable[..., Any], situation: str) -> None:
    d = range_drive(seconds=45, batch=2, seed=7)
    ranges = SITUATIONS[situation](d.ranges)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    runs = [ekf(d.start, d.samples, ranges, d.timing, method=m) for m in ("fast", "exact")]
    # a reset moves the car by hundreds of metres, and its way is told to first order
    assert_equal(*runs, 5e-3 if situation == "drifted" else 1e-4)
    refused = int((runs[1].verdict == Verdict.REFUSED_BY_GATE).sum())
    assert (refused > 20) == (situation in ("wild", "drifted"))
    assert (int(runs[1].resets.sum()) > 0) == (situation in ("jump", "drifted"))


@pytest.mark.parametrize("name", MODELS)
def test_every_model_of_riss_has_a_fast_form(range_drive: Callable[..., Any], name: str) -> None:
    d = range_drive(seconds=45, seed=8)
    vehicle = RissVehicle(MODELS[name])
    start = initial_belief(MODELS[name], d.start.state)
    ranges = jumping(wild(d.ranges))
    ekf = TightEkf(vehicle, systems=2)
    runs = [ekf(start, d.samples, ranges, d.timing, method=m) for m in ("fast", "exact")]
    assert_equal(*runs, 5e-4)


@lru_cache(maxsize=1)
def imu_drive() -> tuple[Any, ...]:
    """A drive of a full IMU from its alignment on, with ranges."""
    log = simulate_drive(
        profile="town",
        grade="mems_m",
        duration=110.0,
        seed=12,
        imu_rate_hz=50.0,
        standstill=15.0,
        satellites=SatelliteOptions(systems=("G", "E")),
    ).log
    line = imu_timeline(log)
    series = ranges_of(log, np.concatenate(([line.start_time], line.t.numpy())))
    found = InsNavigator().align(line.samples, line.fixes, line.timing)
    first = found.sample + 1
    later = series.timing.index >= first
    keep = {k: v[later] for k, v in series.ranges._asdict().items() if k != "system"}
    return (
        found,
        ImuSample(*(x[first:] for x in line.samples)),
        series.ranges._replace(**keep),
        FixTiming(series.timing.index[later] - first, series.timing.delay[later]),
    )


@pytest.mark.parametrize("situation", ["wild", "few", "drifted"])
@pytest.mark.parametrize("states", [15])
def test_full_imu_fast_is_exact(states: int, situation: str) -> None:
    found, samples, ranges, timing = imu_drive()
    options = InsEkfOptions(states=states)
    start = InsNavigator(InsNavigatorOptions(filter=options)).start(found)
    ekf = TightEkf(InsVehicle(options), systems=2)
    job = (start, samples, SITUATIONS[situation](ranges), timing)
    runs = [ekf(*job, method=m) for m in ("fast", "exact")]
    assert_equal(*runs, 5e-3 if situation == "drifted" else 1e-3)
    assert (int(runs[1].resets.sum()) > 0) == (situation == "drifted")


def test_without_any_reception(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=20, batch=2)
    none = SatelliteRanges(*(x[:, :0] for x in d.ranges[:8]), *(x[:, :0] for x in d.ranges[8:]))
    timing = FixTiming(*(x[:, :0] for x in d.timing))
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    runs = [ekf(d.start, d.samples, none, timing, method=m) for m in ("fast", "exact")]
    assert_equal(*runs, 1e-4)


def test_a_batch_is_its_drives(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=40, batch=3, seed=4)
    parts = [f(map_tree(d.ranges, lambda x: x[b])) for b, f in enumerate((wild, few, jumping))]  # noqa: B023
    ranges = SatelliteRanges(*(torch.stack(x) for x in zip(*parts, strict=True)))
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    whole = ekf(d.start, d.samples, ranges, d.timing, method="fast")
    for b, own in enumerate(parts):
        start, samples, timing = map_tree((d.start, d.samples, d.timing), lambda x: x[b])  # noqa: B023
        alone = ekf(start, samples, own, timing, method="fast")
        assert alone.method == whole.method == "fast"
        assert torch.equal(alone.verdict, whole.verdict[b])
        way = enu_between(*alone.trajectory[:3], *(x[b] for x in whole.trajectory[:3]))
        assert float(torch.stack(way).abs().max()) < 1e-4


def gradients(d: Any, ranges: SatelliteRanges, method: str) -> list[Tensor]:
    vehicle = RissVehicle(d.options)
    ekf = TightEkf(vehicle, TightEkfOptions(), systems=2)
    vehicle.log_noise.requires_grad_(True)
    ekf.log_noise.requires_grad_(True)
    far = ranges.pseudorange.clone().requires_grad_()
    gyro = d.samples.yaw_rate.clone().requires_grad_()
    sensor = d.start.sensor.clone().requires_grad_()
    samples: RissSample = d.samples._replace(yaw_rate=gyro)
    start = d.start._replace(sensor=sensor)
    run = ekf(start, samples, ranges._replace(pseudorange=far), d.timing, method=method)
    assert run.method == method
    path = run.trajectory
    east = 6.4e6 * (path.lon * torch.cos(path.lat.detach()))
    loss = (6.4e6 * path.lat).square().mean().sqrt() + east.mean() + run.belief.clock[..., 1].mean()
    loss = loss + run.belief.covariance.diagonal(dim1=-2, dim2=-1)[..., :3].sum(-1).mean()
    leaves = [far, gyro, sensor, vehicle.log_noise, ekf.log_noise]
    return list(torch.autograd.grad(loss, leaves))


@pytest.mark.parametrize("situation", ["plain", "wild", "few"])
def test_gradients_are_those_of_the_loop(range_drive: Callable[..., Any], situation: str) -> None:
    d = range_drive(seconds=40, seed=5)
    ranges = SITUATIONS[situation](d.ranges)
    fast, exact = (gradients(d, ranges, m) for m in ("fast", "exact"))
    for found, wanted in zip(fast, exact, strict=True):
        scale = float(wanted.abs().max())
        assert scale > 0.0
        torch.testing.assert_close(found, wanted, atol=3e-3 * scale, rtol=0.0)


def test_a_vehicle_without_a_fast_form_goes_in_turn() -> None:
    found, samples, ranges, timing = imu_drive()
    options = InsEkfOptions(model="dahmane2022")
    start = InsNavigator(InsNavigatorOptions(filter=options)).start(found)
    short = ImuSample(*(x[:500] for x in samples))
    early = timing.index < 500
    keep = {k: v[early] for k, v in ranges._asdict().items() if k != "system"}
    heard = FixTiming(*(x[early] for x in timing))
    ekf = TightEkf(InsVehicle(options), systems=2)
    run = ekf(start, short, ranges._replace(**keep), heard, method="fast")
    assert run.method == "exact"


def test_passes_that_do_not_converge_go_in_turn(
    range_drive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convergence, "MOST_PASSES", 1)
    d = range_drive(seconds=20)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    run = ekf(d.start, d.samples, d.ranges, d.timing, method="fast")
    assert run.method == "exact"


def test_places_hold_what_is_received() -> None:
    g = torch.Generator().manual_seed(2)
    has = (torch.rand(2, 5, 9, generator=g) < 0.3).double()
    one = torch.ones_like(has)
    number = torch.arange(9).double().expand(2, 5, 9)
    vector = number.unsqueeze(-1).expand(2, 5, 9, 3)
    ranges = SatelliteRanges(
        vector, vector, number, number, one, one, one, one, one.long(), has, 0.0 * has
    )
    packed, places = packed_reception(Reception(ranges, *[one[..., 0]] * 3))
    most = int(has.sum(-1).max())
    assert packed.ranges.has_range.shape == (2, 5, most)
    assert packed.ranges.satellite.shape == (2, 5, most, 3)
    assert torch.equal(packed.ranges.has_range.sum(-1), has.sum(-1))
    assert torch.equal(packed.ranges.pseudorange, packed.ranges.satellite[..., 0])
    back = places.spread(packed.ranges.pseudorange * packed.ranges.has_range, 0.0)
    assert torch.equal(back, number * has)
    both = torch.cat((number, -number), -1)
    assert torch.equal(places.spread(places.packed(both), both), both)
    assert torch.equal(places.packed(both)[..., most:], -places.packed(number))
