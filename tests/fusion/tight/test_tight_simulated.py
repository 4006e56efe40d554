"""A full IMU under simulated satellites: consistency, its own kinds vouched for, its oracle."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.frames import enu_between
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.options import ClockOptions, TightEkfOptions
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.logs.imu_timeline import ImuTimeline, imu_timeline
from navlearn.logs.range_tensors import RangeSeries, ranges_of
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.logs.synthetic.simulated_drive import SimulatedDrive
from navlearn.tight_navigator import TightNavigator, TightNavigatorOptions, TightNavigatorRun

# errors that are white, and a filter that is told so
SKY = SatelliteOptions(
    systems=("G", "E"), ionosphere=0.0, troposphere=0.0, orbit=0.0, multipath=0.0
)
TOLD = TightEkfOptions(
    range_noise=RangeNoiseOptions(
        orbit_clock=0.0,
        ionosphere=0.0,
        troposphere=0.0,
        multipath=0.0,
        thermal=SKY.thermal,
        rate_floor=0.0,
        rate_multipath=0.0,
        rate_thermal=SKY.rate_thermal,
    ),
    clock=ClockOptions(frequency_noise=SKY.clock_white, frequency_walk=SKY.clock_walk),
)


@lru_cache(maxsize=2)
def simulated(seed: int, seconds: float) -> tuple[SimulatedDrive, ImuTimeline, RangeSeries]:
    drive = simulate_drive(
        profile="mixed",
        grade="mems_m",
        duration=seconds,
        seed=seed,
        imu_rate_hz=50.0,
        satellites=SKY,
    )
    line = imu_timeline(drive.log)
    edges = np.concatenate(([float(line.t[0] - line.samples.dt[0])], line.t.numpy()))
    return drive, line, ranges_of(drive.log, edges)


def driven(
    seed: int, seconds: float, method: Any = "fast", **changed: Tensor
) -> tuple[SimulatedDrive, ImuTimeline, TightNavigatorRun]:
    drive, line, series = simulated(seed, seconds)
    chosen = TightNavigatorOptions(vehicle=InsEkfOptions(), tight=TOLD, method=method)
    ranges = series.ranges._replace(**changed)
    run = TightNavigator(chosen).run(line.samples, line.fixes, line.timing, ranges, series.timing)
    return drive, line, run


def interpolated(table: Any, t: Tensor, *names: str) -> list[Tensor]:
    known = table["t"].to_numpy()
    return [torch.tensor(np.interp(t.numpy(), known, table[name].to_numpy())) for name in names]


def errors(
    drive: SimulatedDrive, systems: tuple[str, ...], line: ImuTimeline, run: TightNavigatorRun
) -> dict[str, tuple[Tensor, list[int]]]:
    """Error of groups of states at the ends of blocks, and which states they are."""
    belief = run.history.belief
    t = line.t[run.first :][run.history.end]
    state, true = belief.vehicle.state, drive.log.reference
    place = enu_between(*state[:3], *interpolated(true, t, "lat", "lon", "height"))
    v = torch.stack(interpolated(true, t, "v_e", "v_n", "v_u"), -1)
    assert drive.range_truth is not None
    table = drive.range_truth.table
    first, second = (
        float(table["system_offset"][table["satellite"].str.startswith(letter)].iloc[0])
        for letter in systems
    )
    clock = torch.stack(interpolated(table.drop_duplicates("t"), t, "clock", "clock_rate"), -1)
    clock[:, 0] += first
    n = belief.vehicle.covariance.shape[-1]
    return {
        "position": (torch.stack(place, -1), [0, 1, 2]),
        "velocity": (state.v_l - v, [3, 4, 5]),
        "clock": (belief.clock[..., :2] - clock, [n, n + 1]),
        "offset": (belief.clock[..., 2:] - (second - first), [n + 2]),
    }


@pytest.mark.slow
def test_a_full_imu_knows_how_far_off_it_is() -> None:
    ratios: dict[str, list[float]] = {}
    for seed in (11, 12, 13, 14):
        drive, line, run = driven(seed, 300.0)
        systems = simulated(seed, 300.0)[2].systems
        P = run.history.belief.covariance
        for name, (e, which) in errors(drive, systems, line, run).items():
            part = P[:, which][:, :, which]
            nees = (e * torch.linalg.solve(part, e.unsqueeze(-1)).squeeze(-1)).sum(-1)
            ratios.setdefault(name, []).append(float(nees[20:].mean()) / len(which))
        history = run.history
        count = history.innovation.shape[-1]
        for name, part in (("range", slice(0, count)), ("rate", slice(count, None))):
            nis = history.nis[:, part][history.verdict[:, part] == Verdict.ACCEPTED]
            ratios.setdefault(name, []).append(float(nis.mean()))
        assert float((history.verdict == Verdict.REFUSED_BY_GATE).double().mean()) < 0.004
    mean = {name: float(np.mean(values)) for name, values in ratios.items()}
    # the filter's IMU is a little worse than the simulated one; ranges are as told
    assert 0.5 < mean["position"] < 1.3
    assert 0.3 < mean["velocity"] < 1.3
    assert 0.5 < mean["clock"] < 1.3
    assert 0.3 < mean["offset"] < 2.5
    assert mean["range"] == pytest.approx(1.0, abs=0.12)
    assert mean["rate"] == pytest.approx(1.0, abs=0.2)


def test_the_full_imu_sample_by_sample() -> None:
    _, _, exact = driven(11, 50.0, "exact")
    _, _, slow = driven(11, 50.0, "sequential")
    one, two = exact.history, slow.history
    assert (one.method, two.method) == ("exact", "sequential")
    apart = enu_between(*one.trajectory[:3], *two.trajectory[:3])
    assert max(float(x.abs().max()) for x in apart) < 0.02
    assert float((one.belief.clock - two.belief.clock).abs().max()) < 0.02
    deviation = one.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    other = two.belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    torch.testing.assert_close(deviation, other, rtol=0.02, atol=1e-9)


def test_ranges_vouch_for_the_cars_own_kinds() -> None:
    """A lying odometer is refused for good while ranges tell position; without any it resets."""
    _, line, series = simulated(11, 50.0)
    options = InsEkfOptions()
    samples = line.samples
    moving = samples.speed > 2.0
    fast = torch.where(moving, samples.speed + 25.0, samples.speed)
    told = {}
    for heard in (1.0, 0.0):
        chosen = TightNavigatorOptions(vehicle=options, tight=TOLD, method="exact")
        navigator = TightNavigator(chosen)
        start = navigator.align(samples, line.fixes, line.timing)
        belief = navigator.start(start)
        first = start.sample + 1
        rest = type(samples)(*(x[first:] for x in samples._replace(speed=fast)))
        timing = series.timing
        later = timing.index >= first
        ranges = type(series.ranges)(
            *(x[later] if len(x) == len(later) else x for x in series.ranges)
        )
        ranges = ranges._replace(
            has_range=heard * ranges.has_range, has_rate=heard * ranges.has_rate
        )
        told[heard] = navigator.filter_on(
            navigator.filter(2).start(belief, ranges.has_range.shape[-1]),
            navigator.prepared(rest, start),
            ranges,
            type(timing)(timing.index[later] - first, timing.delay[later]),
        )
    verdict = {heard: h.own_verdict[:, InsKind.ODOMETER] for heard, h in told.items()}
    assert int((verdict[1.0] == Verdict.REFUSED_BY_GATE).sum()) > options.gate.reset_after + 2
    assert not bool((verdict[1.0] == Verdict.ACCEPTED_BY_RESET).any())
    assert bool((verdict[0.0] == Verdict.ACCEPTED_BY_RESET).any())
