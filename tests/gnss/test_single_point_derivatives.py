"""Derivatives of single-point positions against differences."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from navlearn.frames import enu_between
from navlearn.gnss.range_noise import (
    RangeNoiseOptions,
    log_range_noise,
    range_noise_from_log,
)
from navlearn.gnss.single_point import single_point
from navlearn.gnss.single_point_options import SinglePointOptions

MakeSky = Callable[..., Any]
PLAIN = SinglePointOptions(probability=1.0, huber=math.inf)


def test_derivatives_to_pseudoranges(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7, receptions=2, systems=2)
    ranges = sky.noisy()
    options = PLAIN

    def solution(pseudorange: Tensor) -> Tensor:
        found = single_point(ranges._replace(pseudorange=pseudorange), options)
        east, north, up = enu_between(
            found.lat, found.lon, found.height, sky.lat, sky.lon, sky.height
        )
        return torch.cat((torch.stack((east, north, up), -1), found.clock), dim=-1)

    pseudorange = ranges.pseudorange.clone().requires_grad_()
    assert torch.autograd.gradcheck(solution, (pseudorange,), eps=0.1, atol=1e-6, rtol=1e-4)


def test_derivatives_to_noise(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7, receptions=2)
    ranges = sky.noisy()
    options = PLAIN

    def spread(log: Tensor) -> Tensor:
        found = single_point(ranges, options, noise=range_noise_from_log(log))
        return torch.cat((found.covariance.flatten(), found.test))

    log = log_range_noise(RangeNoiseOptions()).requires_grad_()
    assert torch.autograd.gradcheck(spread, (log,), eps=1e-3, atol=1e-4, rtol=1e-4)


def test_derivatives_are_finite_where_nothing_is_solved(make_sky: MakeSky) -> None:
    sky = make_sky(satellites=7)
    has = sky.ranges.has_range.clone()
    has[0], has[1, 2:] = 0.0, 0.0
    pseudorange = sky.ranges.pseudorange.clone().requires_grad_()
    found = single_point(sky.ranges._replace(has_range=has, pseudorange=pseudorange))
    total = found.lat.sum() + found.height.sum() + found.clock.sum() + found.test.sum()
    (gradient,) = torch.autograd.grad(total + found.covariance.sum(), pseudorange)
    assert torch.isfinite(gradient).all()
    assert (gradient[2:] != 0.0).any()
