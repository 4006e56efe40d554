"""Gradients through the whole tight filter, and what must not reach them."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.states import FixTiming, RissSample, SatelliteRanges

RECEPTIONS = 6


def setting(range_drive: Callable[..., Any]) -> tuple[TightEkf, Callable[..., Tensor], Any]:
    """A filter of six receptions, and its end as metres and the clock, of shape (9,)."""
    d = range_drive(seconds=25, satellites=5, seed=6)
    count = RECEPTIONS * 20
    samples = RissSample(*(x[:, :count] for x in d.samples))
    ranges = SatelliteRanges(*(x[:, :RECEPTIONS] for x in d.ranges))
    gone = ranges.has_range.clone()
    gone[0, 3, 1] = 0.0
    wild = ranges.pseudorange.clone()
    wild[0, 2, 4] += 1e5
    wild[0, 3, 1] = torch.nan
    wild[0, 4:] += 299792.458
    ranges = ranges._replace(has_range=gone, pseudorange=wild)
    timing = FixTiming(*(x[:, :RECEPTIONS] for x in d.timing))
    # multipath that lasts: away from the kink at half a second, where it counts as white
    noise = RangeNoiseOptions(rate_told_factor=0.0, multipath_time=2.0)
    options = TightEkfOptions(range_noise=noise)
    ekf = TightEkf(RissVehicle(d.options), options, systems=2)

    def end(given: SatelliteRanges) -> Tensor:
        history = ekf(d.start, samples, given, timing)
        assert history.resets.tolist() == [[0, 1]]
        assert int(history.verdict[0, 2, 4]) == Verdict.REFUSED_BY_GATE
        state, first = history.belief.vehicle.state, d.start.state
        metres = (6.4e6 * (state.lat - first.lat), 4.6e6 * (state.lon - first.lon), state.height)
        place = torch.stack([x[0, -1] for x in (*metres, state.azimuth)])
        sensor = history.belief.vehicle.sensor[0, -1, :2]
        return torch.cat((place, history.belief.clock[0, -1], sensor))

    return ekf, end, ranges


def test_gradcheck_by_the_noise(range_drive: Callable[..., Any]) -> None:
    ekf, end, ranges = setting(range_drive)
    zero = ekf.log_noise.detach() == -torch.inf
    assert int(zero.sum()) == 1
    base = ekf.log_noise.detach()[~zero]

    def of_noise(log: Tensor) -> Tensor:
        full = torch.full_like(ekf.log_noise, -torch.inf).masked_scatter(~zero, log)
        held = ekf._parameters.pop("log_noise")
        ekf.log_noise = full  # type: ignore[assignment]
        try:
            return end(ranges)
        finally:
            del ekf.log_noise
            ekf._parameters["log_noise"] = held

    log = base.clone().requires_grad_()
    assert torch.autograd.gradcheck(
        of_noise, (log,), eps=1e-3, atol=2e-5, rtol=1e-3, fast_mode=True
    )
    grad = torch.autograd.grad(of_noise(log)[:3].sum(), log)[0]
    assert bool(torch.isfinite(grad).all())
    assert int((grad.abs() > 1e-9).sum()) >= 9


@pytest.mark.parametrize("name", ["pseudorange", "range_rate"])
def test_gradcheck_by_what_is_measured(range_drive: Callable[..., Any], name: str) -> None:
    _, end, ranges = setting(range_drive)
    has = ranges.has_range if name == "pseudorange" else ranges.has_rate
    there = has > 0.5
    value = getattr(ranges, name)

    def of_measured(used: Tensor) -> Tensor:
        return end(ranges._replace(**{name: value.masked_scatter(there, used)}))

    used = value[there].clone().requires_grad_()
    assert torch.autograd.gradcheck(
        of_measured, (used,), eps=1e-3, atol=1e-6, rtol=1e-5, fast_mode=True
    )


def test_what_is_refused_or_absent_has_no_gradient(range_drive: Callable[..., Any]) -> None:
    _, end, ranges = setting(range_drive)
    leaves = [x.clone().requires_grad_(x.dtype == torch.float64) for x in ranges]
    end(SatelliteRanges(*leaves)).sum().backward()
    for name, leaf in zip(ranges._fields, leaves, strict=True):
        if leaf.grad is not None:
            assert bool(torch.isfinite(leaf.grad).all()), name
    by_range = leaves[2].grad
    assert by_range is not None
    assert float(by_range[0, 3, 1]) == 0.0
    assert float(by_range[0, 2, 4]) == 0.0
    used = torch.ones_like(by_range, dtype=torch.bool)
    used[0, 3, 1] = used[0, 2, 4] = False
    assert bool((by_range[used].abs() > 0.0).all())


def test_gradients_reach_the_vehicles_noise(range_drive: Callable[..., Any]) -> None:
    ekf, end, ranges = setting(range_drive)
    vehicle: Any = ekf.vehicle
    vehicle.log_noise.requires_grad_(True)
    ekf.log_noise.requires_grad_(True)
    assert {name for name, _ in ekf.named_parameters()} == {"log_noise", "vehicle.log_noise"}
    end(ranges)[:3].sum().backward()
    assert int((vehicle.log_noise.grad.abs() > 1e-9).sum()) >= 3
