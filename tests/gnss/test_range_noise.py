"""How noisy ranges are, against figures worked out by hand and against gradients."""

import dataclasses
import math

import pytest
import torch
from scipy.signal import lfilter

from navlearn.errors import ConfigError
from navlearn.gnss.klobuchar import ionosphere_obliquity
from navlearn.gnss.range_noise import (
    RangeNoise,
    RangeNoiseOptions,
    log_range_noise,
    range_noise,
    range_noise_from_log,
    range_variance,
    rate_variance,
)
from navlearn.gnss.troposphere import slant_factor

SILENT = {entry.name: 0.0 for entry in dataclasses.fields(RangeNoiseOptions)}


def of(**values: float) -> RangeNoise:
    return range_noise(RangeNoiseOptions(**{**SILENT, **values}))


def double(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_options_and_tuple_name_the_same_entries() -> None:
    assert RangeNoise._fields == tuple(e.name for e in dataclasses.fields(RangeNoiseOptions))


def test_thermal_noise_grows_tenfold_per_20_db() -> None:
    cn0 = double(45.0, 35.0, 25.0)
    found = range_variance(of(thermal=0.5), double(1.0, 1.0, 1.0), cn0, torch.zeros(3))
    torch.testing.assert_close(found, double(0.25, 2.5, 25.0))
    found = rate_variance(of(rate_thermal=0.1), double(1.0, 1.0, 1.0), cn0, torch.zeros(3))
    torch.testing.assert_close(found, double(0.01, 0.1, 1.0))


def test_multipath_by_elevation() -> None:
    elevation = double(math.pi / 2, math.pi / 6)
    cn0, told = torch.full((2,), 45.0), torch.zeros(2)
    found = range_variance(of(multipath=3.0), elevation, cn0, told)
    torch.testing.assert_close(found, double(9.0, 36.0))
    found = rate_variance(of(rate_multipath=3.0), elevation, cn0, told)
    torch.testing.assert_close(found, double(9.0, 36.0))


def test_what_the_receiver_tells_stands_for_thermal_noise_alone() -> None:
    noise = of(thermal=0.5, orbit_clock=2.0, told_factor=3.0)
    cn0, told = torch.full((2,), 45.0), double(0.0, 1.0)
    found = range_variance(noise, double(1.0, 1.0), cn0, told)
    torch.testing.assert_close(found, double(4.25, 13.0))


def test_obliquity_at_zenith_and_horizon() -> None:
    # a shell 350 km up: secant of the zenith angle there, which the polynomial approximates
    elevation = double(math.pi / 2, math.radians(30.0), math.radians(5.0))
    sine = 6371.0 / (6371.0 + 350.0) * torch.cos(elevation)
    shell = 1.0 / torch.sqrt(1.0 - sine**2)
    torch.testing.assert_close(ionosphere_obliquity(elevation), shell, rtol=0.05, atol=0.0)


def test_mapping_near_the_cosecant() -> None:
    elevation = double(math.pi / 2, math.radians(30.0), math.radians(15.0))
    torch.testing.assert_close(
        slant_factor(elevation), 1.0 / torch.sin(elevation), rtol=0.02, atol=0.0
    )


def test_nothing_grows_below_the_lowest_elevation() -> None:
    noise = range_noise(RangeNoiseOptions())
    elevation = double(math.radians(5.0), 0.0, -1.0)
    cn0, told = torch.full((3,), 40.0), torch.zeros(3)
    for variance in (range_variance, rate_variance):
        found = variance(noise, elevation, cn0, told)
        assert torch.equal(found, found[:1].expand(3))


def test_defaults_are_those_of_a_cheap_receiver() -> None:
    noise = range_noise(RangeNoiseOptions())
    elevation = torch.deg2rad(double(90.0, 45.0, 15.0))
    deviation = range_variance(noise, elevation, torch.full((3,), 45.0), torch.zeros(3)).sqrt()
    assert (deviation > double(1.5, 2.0, 4.0)).all()
    assert (deviation < double(2.5, 3.5, 7.0)).all()


def test_log_goes_back_and_carries_gradients() -> None:
    options = RangeNoiseOptions(orbit_clock=0.0, multipath_time=2.0)
    log = log_range_noise(options).requires_grad_()
    back = range_noise_from_log(log)
    torch.testing.assert_close(torch.stack(tuple(back)), torch.stack(tuple(range_noise(options))))
    elevation, cn0, told = double(0.3, 1.0), double(30.0, 45.0), double(0.0, 0.4)
    often = torch.full_like(told, 0.2)
    total = range_variance(back, elevation, cn0, told, often).sum()
    total = total + rate_variance(back, elevation, cn0, told).sum()
    (gradient,) = torch.autograd.grad(total, log)
    assert torch.isfinite(gradient).all()
    zero = RangeNoise._fields.index("orbit_clock")
    moved = [i for i in range(len(RangeNoise._fields)) if i != zero]
    assert (gradient[moved] > 0.0).all()
    assert gradient[zero] == 0.0


def test_often_heard_multipath_tells_no_more_than_its_mean() -> None:
    tau, every, count = 4.0, 0.5, 400_000
    generator = torch.Generator().manual_seed(1)
    kept = math.exp(-every / tau)
    drawn = torch.randn(count, generator=generator, dtype=torch.float64).numpy()
    error = lfilter([math.sqrt(1.0 - kept**2)], [1.0, -kept], drawn)
    length = 400  # 200 s, many correlation times
    spread = error.reshape(-1, length).mean(1).var() * length
    noise = of(multipath=1.0, multipath_time=tau)
    zenith, one = double(0.5 * math.pi), double(45.0)
    plain = range_variance(noise, zenith, one, double(1e-9))
    often = range_variance(noise, zenith, one, double(1e-9), double(every))
    assert float(often / plain) == pytest.approx(2.0 * tau / every)
    assert float(often) == pytest.approx(spread, rel=0.1)
    seldom = range_variance(noise, zenith, one, double(1e-9), double(10.0 * tau))
    torch.testing.assert_close(seldom, plain)


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_refuses_what_is_no_deviation(value: float) -> None:
    with pytest.raises(ConfigError, match="multipath"):
        RangeNoiseOptions(multipath=value)
