"""Velocities from range rates against the motion that made them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import torch
from torch import Tensor

from navlearn.frames import enu_from_ecef_matrix
from navlearn.gnss.range_noise import RangeNoiseOptions, range_noise, rate_variance
from navlearn.gnss.range_rate_velocity import range_rate_velocity
from navlearn.gnss.single_point import Reason
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.states import SatelliteRanges

MakeSky = Callable[..., Any]
PLAIN = SinglePointOptions(probability=1.0, huber=math.inf)


def place(sky: Any) -> tuple[Tensor, Tensor, Tensor]:
    return sky.lat, sky.lon, sky.height


def deviations(ranges: SatelliteRanges) -> Tensor:
    noise = range_noise(RangeNoiseOptions())
    return rate_variance(noise, ranges.elevation, ranges.cn0, ranges.std_rate).sqrt()


@pytest.mark.parametrize("systems", [1, 3])
def test_exact_without_noise(make_sky: MakeSky, systems: int) -> None:
    sky = make_sky(satellites=8, systems=systems)
    found = range_rate_velocity(sky.ranges, place(sky))
    assert found.ok.all()
    # differenced over a millisecond, ranges of 2e7 m tell rates to 1e-5 m/s
    torch.testing.assert_close(found.v_l, sky.velocity, atol=2e-4, rtol=0.0)
    torch.testing.assert_close(found.drift, sky.drift, atol=2e-4, rtol=0.0)
    assert (found.degrees == 4).all()


def test_as_scipy_solves_it(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=9, receptions=1)
    draw = torch.Generator().manual_seed(3)
    error = deviations(sky.ranges) * torch.randn(1, 9, generator=draw, dtype=torch.float64)
    ranges = sky.ranges._replace(range_rate=sky.ranges.range_rate + error)
    found = range_rate_velocity(ranges, place(sky), PLAIN)
    turn = enu_from_ecef_matrix(sky.lat, sky.lon)[0].numpy()
    weight = 1.0 / deviations(ranges)[0].numpy()
    unit = sky.unit[0].numpy()
    observed = ranges.range_rate[0].numpy() - (
        unit * (ranges.satellite_velocity[0].numpy() @ turn.T)
    ).sum(-1)
    design = np.column_stack((-unit, np.ones(9)))
    other, square, *_ = scipy.linalg.lstsq(design * weight[:, None], observed * weight)
    np.testing.assert_allclose(found.v_l[0].numpy(), other[:3], atol=1e-6)
    assert float(found.drift[0]) == pytest.approx(other[3], abs=1e-6)
    assert float(found.test[0]) == pytest.approx(float(square), rel=1e-6)


def test_covariance_by_monte_carlo(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7, receptions=1, seed=3)
    many = SatelliteRanges(
        *(
            value if name == "system" else value.expand(4000, *value.shape[1:])
            for name, value in sky.ranges._asdict().items()
        )
    )
    draw = torch.Generator().manual_seed(4)
    error = deviations(many) * torch.randn(4000, 7, generator=draw, dtype=torch.float64)
    many = many._replace(range_rate=many.range_rate + error)
    found = range_rate_velocity(many, place(sky), PLAIN)
    off = found.v_l - sky.velocity
    torch.testing.assert_close(off.T @ off / 4000, found.covariance[0], rtol=0.1, atol=1e-3)
    drift = found.drift - sky.drift
    assert float(drift.std()) == pytest.approx(float(found.drift_std[0]), rel=0.05)
    assert float(found.test.mean()) == pytest.approx(3.0, abs=0.16)


@pytest.mark.parametrize("size", [3.0, 100.0, 1e5])
def test_one_wild_rate_is_excluded(make_sky: MakeSky, size: float) -> None:
    sky = make_sky(satellites=9, receptions=9)
    rate = sky.ranges.range_rate + size * torch.eye(9, dtype=torch.float64)
    found = range_rate_velocity(sky.ranges._replace(range_rate=rate), place(sky))
    assert found.ok.all()
    assert torch.equal(found.excluded, torch.eye(9, dtype=torch.float64))
    torch.testing.assert_close(found.v_l, sky.velocity, atol=2e-4, rtol=0.0)


def test_a_reason_for_each_refusal(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=5, receptions=4)
    has, rate = sky.ranges.has_rate.clone(), sky.ranges.range_rate.clone()
    has[0, 3:] = 0.0
    rate[1, 0] += 50.0
    rate[2] += sky.unit[2] @ torch.tensor([300.0, 0.0, 0.0], dtype=torch.float64)
    found = range_rate_velocity(sky.ranges._replace(has_rate=has, range_rate=rate), place(sky))
    wanted = [Reason.TOO_FEW, Reason.INCONSISTENT, Reason.IMPLAUSIBLE, Reason.SOLVED]
    assert found.reason.tolist() == wanted
    assert found.ok.tolist() == [False, False, False, True]


def test_satellites_in_one_direction_tell_no_velocity(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=6)
    same = SatelliteRanges(
        *(v if v is sky.ranges.system else v[:, :1].expand_as(v) for v in sky.ranges)
    )
    assert (range_rate_velocity(same, place(sky)).reason == Reason.GEOMETRY).all()


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_senseless_values_are_left_out(make_sky: MakeSky, value: float) -> None:
    sky = make_sky(satellites=9)
    rate, velocity = sky.ranges.range_rate.clone(), sky.ranges.satellite_velocity.clone()
    rate[:, 0], velocity[:, 1, 0] = value, value
    ranges = sky.ranges._replace(range_rate=rate, satellite_velocity=velocity)
    found = range_rate_velocity(ranges, place(sky))
    assert found.ok.all()
    assert (found.satellites == 7).all()
    torch.testing.assert_close(found.v_l, sky.velocity, atol=2e-4, rtol=0.0)
    for part in (found.residual, found.covariance, found.test):
        assert torch.isfinite(part).all()


def test_derivatives(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=6, receptions=2)
    rate = sky.ranges.range_rate.clone().requires_grad_()

    def solution(rate: Tensor) -> Tensor:
        found = range_rate_velocity(sky.ranges._replace(range_rate=rate), place(sky))
        return torch.cat((found.v_l, found.drift.unsqueeze(-1)), dim=-1)

    assert torch.autograd.gradcheck(solution, (rate,), eps=1e-3, atol=1e-7)
