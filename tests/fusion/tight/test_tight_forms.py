"""The tight filter in its forms: without satellites, in batches, sample by sample, streaming."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.attitude import quaternion_from_angles
from navlearn.filters.tight_belief import map_tight_belief, map_tree
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.tight.ins_vehicle import InsVehicle
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.logs.imu_timeline import imu_timeline
from navlearn.logs.synthetic import simulate_drive
from navlearn.states import FixTiming, GnssFix, InsState, RissSample, SatelliteRanges


def nothing(shape: tuple[int, ...], satellites: int = 3) -> SatelliteRanges:
    """Receptions at which no satellite is measured; everything is NaN."""
    nan = torch.full((*shape, satellites), torch.nan, dtype=torch.float64)
    vector = nan.unsqueeze(-1).expand(*nan.shape, 3)
    none, system = torch.zeros_like(nan), torch.zeros(nan.shape, dtype=torch.int64)
    return SatelliteRanges(vector, vector, nan, nan, nan, nan, nan, nan, system, none, none)


def no_fixes(timing: FixTiming) -> GnssFix:
    return GnssFix(*(torch.zeros_like(timing.delay) for _ in GnssFix._fields))


def assert_same(found: Any, wanted: Any, **tolerance: float) -> None:
    if isinstance(found, Tensor):
        torch.testing.assert_close(found, wanted, equal_nan=True, **tolerance)
        return
    if isinstance(found, tuple):
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other, **tolerance)


def take(ranges: SatelliteRanges, keep: Any) -> SatelliteRanges:
    return SatelliteRanges(*(channel[keep] for channel in ranges))


@pytest.mark.parametrize(
    "options",
    [EkfOptions(), EkfOptions(model="shen2010_full"), EkfOptions(lever_arm=(0.5, 1.0, 1.2))],
)
def test_without_satellites_riss_is_the_loosely_coupled_filter(
    make_drive: Callable[..., Any], model_start: Callable[..., Any], options: EkfOptions
) -> None:
    d = make_drive(seconds=30, batch=2)
    start = model_start(options, d.start)
    loose = LooselyCoupledEkf(options)(start, d.samples, no_fixes(d.timing), d.timing)
    ekf = TightEkf(RissVehicle(options), systems=2)
    tight = ekf(start, d.samples, nothing((2, 30)), d.timing)
    assert_same(tight.trajectory, loose.trajectory, atol=1e-11, rtol=1e-13)
    assert_same(tight.belief.vehicle, loose.belief, atol=1e-9, rtol=1e-10)
    assert_same(tight.own_innovation, loose.innovation, atol=1e-11, rtol=1e-9)
    assert torch.equal(tight.own_verdict, loose.verdict)
    assert bool((tight.own_verdict == Verdict.ACCEPTED).any())
    assert bool((tight.verdict == Verdict.ABSENT).all())
    # no reception at all: blocks end every second all the same
    empty = FixTiming(torch.zeros(2, 0, dtype=torch.int64), torch.zeros(2, 0).double())
    alone = ekf(start, d.samples, nothing((2, 0)), empty)
    assert_same(alone.trajectory, loose.trajectory, atol=1e-11, rtol=1e-13)


@pytest.mark.parametrize("states", [15, 21])
def test_without_satellites_a_full_imu_is_the_loosely_coupled_filter(states: int) -> None:
    log = simulate_drive(
        profile="town", grade="mems_m", duration=25.0, seed=12, imu_rate_hz=50.0, standstill=5.0
    ).log
    line, first = imu_timeline(log), log.reference.iloc[0]
    vector = lambda *names: torch.tensor([float(first[n]) for n in names]).double()  # noqa: E731
    attitude = quaternion_from_angles(*vector("azimuth", "pitch", "roll").unbind())
    place = vector("lat", "lon", "height").unbind()
    state = InsState(*place, vector("v_e", "v_n", "v_u"), attitude)
    options = InsEkfOptions(states=states)
    start = initial_ins_belief(options, state)
    timing = line.timing
    loose = InsEkf(options)(start, line.samples, no_fixes(timing), timing)
    ekf = TightEkf(InsVehicle(options))
    tight = ekf(start, line.samples, nothing(tuple(timing.index.shape)), timing)
    assert_same(tight.trajectory, loose.trajectory, atol=1e-9, rtol=1e-12)
    assert_same(tight.belief.vehicle, loose.belief, atol=1e-8, rtol=1e-7)
    assert torch.equal(tight.own_verdict, loose.verdict)
    assert bool((tight.own_verdict == Verdict.ACCEPTED).any())


def test_a_batch_is_its_drives(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=25, batch=3, seed=4)
    has = d.ranges.has_range.clone()
    has[1, 5:15] = 0.0
    has[2, :, 3:] = 0.0
    wild = d.ranges.pseudorange.clone()
    wild[1, 18:, 2] += 1e5
    wild[2, 12:] += 3e5
    ranges = d.ranges._replace(has_range=has, pseudorange=wild)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    whole = ekf(d.start, d.samples, ranges, d.timing)
    assert whole.resets.tolist() == [[0, 0], [0, 0], [0, 1]]
    for b in range(3):
        alone = ekf(
            map_tree(d.start, lambda x: x[b]),  # noqa: B023
            RissSample(*(x[b] for x in d.samples)),
            take(ranges, b),
            FixTiming(*(x[b] for x in d.timing)),
        )
        member = map_tree(whole, lambda x: x[b])  # noqa: B023
        assert_same(alone, member, atol=1e-8, rtol=1e-7)


def test_sample_by_sample(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=20)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    exact = ekf(d.start, d.samples, d.ranges, d.timing)
    slow = ekf(d.start, d.samples, d.ranges, d.timing, method="sequential")
    assert (exact.method, slow.method) == ("exact", "sequential")
    metres = 6.4e6 * (exact.trajectory.lat - slow.trajectory.lat).abs().max()
    assert float(metres) < 1e-3
    assert_same(exact.belief.covariance, slow.belief.covariance, atol=1e-4, rtol=3e-3)


def test_streaming_is_the_run(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=12, seed=2)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    run = ekf(d.start, d.samples, d.ranges, d.timing, silence=torch.zeros(1).double())
    belief = ekf.start(d.start, 8)
    rate = 20
    for k in range(12):
        stretch = RissSample(*(x[:, k * rate : (k + 1) * rate] for x in d.samples))
        belief = ekf.step(belief, stretch)
        belief = ekf.update(belief, take(d.ranges, (slice(None), k)), stretch)
        at = map_tight_belief(run.belief, lambda x: x[:, k])  # noqa: B023
        assert_same(belief, at, atol=1e-9, rtol=1e-9)
    late = ekf.update(
        belief, take(d.ranges, (slice(None), 11)), stretch, delay=torch.full((1,), 0.1).double()
    )
    assert not torch.equal(
        late.clock, ekf.update(belief, take(d.ranges, (slice(None), 11)), stretch).clock
    )


def test_the_future_changes_nothing(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=30, seed=3)
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    before = ekf(d.start, d.samples, d.ranges, d.timing)
    other = d.ranges.pseudorange.clone()
    other[:, 20:] += 50.0 * torch.rand(8, dtype=torch.float64)
    after = ekf(d.start, d.samples, d.ranges._replace(pseudorange=other), d.timing)
    for name in ("belief", "prior", "innovation", "nis", "verdict", "residual"):
        one, two = (map_tree(getattr(h, name), lambda x: x[:, :20]) for h in (before, after))
        assert_same(one, two, atol=0.0, rtol=0.0)
    assert torch.equal(before.trajectory.lat[:, :419], after.trajectory.lat[:, :419])
    assert not torch.equal(before.trajectory.lat[:, 419:], after.trajectory.lat[:, 419:])
    # nor does how often ranges come later on
    keep = [0, 1, 2, *range(5, 30, 5)]
    fewer = SatelliteRanges(*(x[:, keep] if x.dim() > 2 else x for x in d.ranges))
    rare = ekf(d.start, d.samples, fewer, FixTiming(*(x[:, keep] for x in d.timing)))
    assert torch.equal(before.trajectory.lat[:, :79], rare.trajectory.lat[:, :79])


def test_a_late_reception_is_taken_where_the_car_was(range_drive: Callable[..., Any]) -> None:
    """Ranges used three samples late, with their delay told, say what they say in time."""
    d = range_drive(seconds=30, noise=None)
    # delays change how long a reception lies back: what each counts for must not depend on that
    white = RangeNoiseOptions(multipath_time=0.0)
    ekf = TightEkf(RissVehicle(d.options), TightEkfOptions(range_noise=white), systems=2)
    in_time = ekf(d.start, d.samples, d.ranges, d.timing)
    index = (d.timing.index + 3).clamp(max=d.samples.dt.shape[1] - 1)
    late = FixTiming(index, (index - d.timing.index).double() * 0.05)
    told = ekf(d.start, d.samples, d.ranges, late)
    lied = ekf(d.start, d.samples, d.ranges, late._replace(delay=torch.zeros_like(late.delay)))
    ahead = [
        6.4e6 * float((h.trajectory.lat - in_time.trajectory.lat)[:, 300:].abs().max())
        for h in (told, lied)
    ]
    assert ahead[0] < 0.4
    assert ahead[1] > 1.0


def test_residuals_are_against_the_belief_after(range_drive: Callable[..., Any]) -> None:
    d = range_drive(seconds=20, seed=5)
    wild = d.ranges.pseudorange.clone()
    wild[:, 10, 4] += 500.0
    ekf = TightEkf(RissVehicle(d.options), systems=2)
    run = ekf(d.start, d.samples, d.ranges._replace(pseudorange=wild), d.timing)
    assert float(run.residual[0, 10, 4]) == pytest.approx(500.0, abs=15.0)
    others = [k for k in range(8) if k != 4]
    assert float(run.residual[0, 10, others].abs().max()) < 15.0
    # after the update they are smaller than before
    assert float(run.residual[0, 2:9].square().mean()) < float(
        run.innovation[0, 2:9].square().mean()
    )
