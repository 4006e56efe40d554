"""Predicted ranges and rates, their derivatives, what is masked, and the clock."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from navlearn.filters.discretize import van_loan
from navlearn.frames import ecef_from_geodetic, shift_geodetic
from navlearn.fusion.tight.clock import advanced_clock, clock_names, clock_noise, clock_transition
from navlearn.fusion.tight.noise import log_tight_noise, tight_noise_from_log
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.ranges import measured_ranges, with_surprise
from navlearn.fusion.tight.timeline import Reception, _since_reception, usable
from navlearn.fusion.tight.vehicle import Antenna
from navlearn.gnss.range_noise import range_variance
from navlearn.states import SatelliteRanges

NOISE = tight_noise_from_log(log_tight_noise(TightEkfOptions()))
LIGHT = 299792458.0
EARTH_RATE = 7.292115e-5


def vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def antenna(correction: Tensor, delay: Tensor) -> Antenna:
    """A point with six states, position and velocity, moved by a correction."""
    lat, lon, height = shift_geodetic(*vector(0.8, -1.3, 250.0).unbind(), *correction[:3].unbind())
    v = vector(12.0, -7.0, 1.0) + correction[3:6]
    one = torch.eye(3, dtype=torch.float64)
    wide = torch.cat((one, 0.0 * one), 1)
    return Antenna(lat, lon, height, v, wide, wide.roll(3, 1), vector(0.01, 0.02, 0.03))


def reception(make_ranges: Any, make_car: Any, delay: float = 0.0) -> Reception:
    here = [x.reshape(1, 1) for x in vector(0.8, -1.3, 250.0)]
    car = make_car(*here, vector(12.0, -7.0, 1.0).reshape(1, 1, 3))
    time, one = vector(30.0), torch.ones(1, 1, dtype=torch.float64)
    ranges = make_ranges(car, time, 800.0 * one, 55.0 * one, offsets=(0.0, 20.0, -30.0))
    one_time = SatelliteRanges(*(x[0, 0] for x in ranges))
    return Reception(
        one_time, vector(delay).squeeze(), vector(1.0).squeeze(), vector(1.0).squeeze()
    )


def test_ranges_and_rates_of_inertial_axes(
    make_ranges: Callable[..., Any], make_car: Callable[..., Any]
) -> None:
    # the fixture computes rates from inertial velocities, in Cartesian axes
    clock = vector(800.0, 55.0, 20.0, -30.0)
    at = antenna(torch.zeros(6, dtype=torch.float64), vector(0.0).squeeze())
    found = measured_ranges(at, clock, reception(make_ranges, make_car), NOISE)
    assert float(found.innovation[:8].abs().max()) < 1e-7
    assert float(found.innovation[8:].abs().max()) < 1e-9


def test_rate_is_the_change_of_the_way_of_light() -> None:
    """A satellite on a circle in inertial axes, sending to a car on the turning Earth; the way of
    light by iteration, its rate by differences over a tenth of a second."""
    car = ecef_from_geodetic(*vector(0.8, -1.3, 250.0).unbind())

    def turned(x: Tensor, angle: float) -> Tensor:
        c, s = math.cos(angle), math.sin(angle)
        return torch.stack((c * x[0] - s * x[1], s * x[0] + c * x[1], x[2]))

    def satellite(t: float) -> Tensor:  # inertial
        angle = 1.3 - 1.4585e-4 * t
        plane = vector(math.cos(angle), 0.6 * math.sin(angle), 0.8 * math.sin(angle))
        return 2.656e7 * turned(plane, -1.1)

    def way(t: float) -> tuple[float, float]:
        here, travel = turned(car, EARTH_RATE * t), 0.07
        for _ in range(6):
            travel = float((satellite(t - travel) - here).norm()) / LIGHT
        return LIGHT * travel, t - travel

    _, sent = way(0.0)
    slope = (satellite(sent + 0.05) - satellite(sent - 0.05)) / 0.1
    spin = vector(0.0, 0.0, EARTH_RATE)
    place = satellite(sent)  # axes of the Earth at t = 0, the moment of reception
    against_earth = slope - torch.linalg.cross(spin, place)
    zero, one = vector(0.0), vector(1.0)
    ranges = SatelliteRanges(
        place[None],
        against_earth[None],
        zero,
        zero,
        one,
        45 * one,
        zero,
        zero,
        zero.long(),
        one,
        one,
    )
    still = antenna(torch.zeros(6, dtype=torch.float64), zero[0])
    still = still._replace(velocity=torch.zeros(3, dtype=torch.float64))
    found = measured_ranges(
        still,
        torch.zeros(2, dtype=torch.float64),
        Reception(ranges, zero[0], one[0], one[0]),
        NOISE,
    )
    rate = (way(0.05)[0] - way(-0.05)[0]) / 0.1
    assert float(found.innovation[0]) == pytest.approx(-way(0.0)[0], abs=1e-6)
    assert abs(rate) > 300.0
    assert float(found.innovation[1]) == pytest.approx(-rate, abs=2e-5)


@pytest.mark.parametrize("delay", [0.0, 0.13])
def test_derivatives_are_those_of_the_predictions(
    make_ranges: Callable[..., Any], make_car: Callable[..., Any], delay: float
) -> None:
    seen = reception(make_ranges, make_car, delay)
    clock = vector(800.0, 55.0, 20.0, -30.0)

    def predicted(correction: Tensor) -> Tensor:
        at = antenna(correction[:6], seen.delay)
        return -measured_ranges(at, clock + correction[6:], seen, NOISE).innovation

    zero = torch.zeros(10, dtype=torch.float64)
    H = measured_ranges(antenna(zero[:6], seen.delay), clock, seen, NOISE).observation
    found = torch.func.jacrev(predicted)(zero)
    assert H.shape == (16, 13)
    # by position the rate also turns with east, north and up: 20 m/s over the Earth's radius
    torch.testing.assert_close(H[:, :10], found, atol=6e-6, rtol=1e-9)
    torch.testing.assert_close(H[8:, 10:], H[8:, 3:6], atol=0.0, rtol=0.0)
    assert float(H[:8, 10:].abs().max()) == 0.0
    # the terms by position are there, and larger than what is neglected
    assert float(H[8:, :3].abs().max()) > 2e-5


def test_systems_share_the_bias_and_have_their_offset(
    make_ranges: Callable[..., Any], make_car: Callable[..., Any]
) -> None:
    seen = reception(make_ranges, make_car, 0.25)
    zero = torch.zeros(6, dtype=torch.float64)
    found = measured_ranges(antenna(zero, seen.delay), torch.zeros(4).double(), seen, NOISE)
    by_clock = found.observation[:, 6:10]
    for s, system in enumerate(seen.ranges.system.tolist()):
        want = [1.0, -0.25, float(system == 1), float(system == 2)]
        assert by_clock[s].tolist() == want
        assert by_clock[8 + s].tolist() == [0.0, 1.0, 0.0, 0.0]


def test_what_is_not_measured_leaves_no_trace(
    make_ranges: Callable[..., Any], make_car: Callable[..., Any]
) -> None:
    seen = reception(make_ranges, make_car)
    ranges = seen.ranges
    gone = torch.tensor([0.0, 1, 1, 1, 1, 1, 1, 1]).double()
    nan = torch.where(gone > 0.5, 1.0, torch.nan)
    spoilt = ranges._replace(
        satellite=ranges.satellite * nan.unsqueeze(-1),
        satellite_velocity=ranges.satellite_velocity * nan.unsqueeze(-1),
        pseudorange=ranges.pseudorange * nan,
        range_rate=ranges.range_rate * nan,
        cn0=ranges.cn0 * nan,
        elevation=ranges.elevation * nan,
        std_range=ranges.std_range * nan,
        std_rate=ranges.std_rate * nan,
        has_range=gone,
        has_rate=gone,
    )
    leaves = [x.clone().requires_grad_(x.dtype == torch.float64) for x in spoilt]
    correction = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    clean = usable(TightEkfOptions(), SatelliteRanges(*leaves))
    clock = vector(800.0, 55.0, 20.0, -30.0).requires_grad_()
    found = measured_ranges(
        antenna(correction, seen.delay), clock, Reception(clean, *seen[1:]), NOISE
    )
    assert bool(torch.isfinite(found.innovation).all())
    assert float(found.observation[0].detach().abs().max()) == 0.0
    assert found.variance[0] == 1.0
    total = (found.innovation**2).sum() + found.observation.sum() + found.variance.sum()
    grads = torch.autograd.grad(total, [correction, clock, leaves[0], leaves[2]])
    assert all(bool(torch.isfinite(g).all()) for g in grads)
    assert float(grads[2][0].abs().max()) == 0.0


def test_masks(make_ranges: Callable[..., Any], make_car: Callable[..., Any]) -> None:
    ranges = reception(make_ranges, make_car).ranges
    cn0 = ranges.cn0.clone()
    cn0[3] = 19.0
    low = ranges.elevation.clone()
    low[5] = math.radians(7.0)
    seen = usable(TightEkfOptions(), ranges._replace(cn0=cn0, elevation=low))
    assert seen.has_range.tolist() == [1, 1, 1, 0, 1, 0, 1, 1]
    assert seen.has_rate.tolist() == [1, 1, 1, 0, 1, 0, 1, 1]
    seen = usable(TightEkfOptions(use_rates=False, least_cn0=0.0, elevation_mask=0.0), ranges)
    assert seen.has_range.tolist() == [1] * 8
    assert seen.has_rate.tolist() == [0] * 8


def test_variance_is_that_of_the_range_noise(
    make_ranges: Callable[..., Any], make_car: Callable[..., Any]
) -> None:
    seen = reception(make_ranges, make_car)
    zero = torch.zeros(6, dtype=torch.float64)
    found = measured_ranges(antenna(zero, seen.delay), torch.zeros(4).double(), seen, NOISE)
    r = seen.ranges
    want = range_variance(NOISE.range, r.elevation, r.cn0, r.std_range)
    torch.testing.assert_close(found.variance[:8], want)


def test_surprises_stand_beside_the_states() -> None:
    P = torch.eye(8, dtype=torch.float64) * 4.0
    wide = with_surprise(P, antenna(torch.zeros(6).double(), vector(0.0)))
    assert wide.diagonal().tolist() == [4.0] * 8 + [0.01, 0.02, 0.03]
    assert float((wide - torch.diag(wide.diagonal())).abs().max()) == 0.0


def test_the_clock_is_discretised_exactly() -> None:
    dt = vector(0.1, 1.0, 7.0)
    F = torch.zeros(4, 4, dtype=torch.float64)
    F[0, 1] = 1.0
    density = vector(0.1, 0.2, 0.005, 0.005) ** 2
    transition, q = van_loan(F.expand(3, 4, 4), torch.diag(density).expand(3, 4, 4), dt)
    torch.testing.assert_close(clock_transition(dt, 3), transition)
    torch.testing.assert_close(clock_noise(dt, 3, NOISE), q)
    clock = vector(5.0, 2.0, 1.0, -1.0).expand(3, 4)
    moved = (transition @ clock.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(advanced_clock(clock, dt), moved)
    assert clock_names(3) == ("clock_bias", "clock_drift", "system_offset_1", "system_offset_2")
    twice = clock_transition(vector(1.0), 3) @ clock_noise(vector(1.0), 3, NOISE)
    twice = twice @ clock_transition(vector(1.0), 3).mT + clock_noise(vector(1.0), 3, NOISE)
    torch.testing.assert_close(clock_noise(vector(2.0), 3, NOISE), twice)


def test_what_a_reception_counts_for_depends_on_the_one_before() -> None:
    elapsed = torch.tensor([[1.0, 0.1, 0.9, 1.0, 3.0], [0.1, 1.0, 2.0, 0.5, 0.5]]).double()
    heard = torch.tensor([[True, False, True, True, False], [False, False, True, False, False]])
    since = _since_reception(elapsed, heard, None)
    # the first of all stands for itself
    assert since[0].tolist() == pytest.approx([math.inf, 0.1, 1.0, 1.0, 3.0])
    assert since[1].tolist() == pytest.approx([math.inf, math.inf, math.inf, 0.5, 1.0])
    later = _since_reception(elapsed, heard, torch.tensor([0.0, 0.4]).double())
    assert later[0].tolist() == pytest.approx([1.0, 0.1, 1.0, 1.0, 3.0])
    assert later[1].tolist() == pytest.approx([0.5, 1.5, 3.5, 0.5, 1.0])
