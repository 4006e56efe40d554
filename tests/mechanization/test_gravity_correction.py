"""The correction of a path by gravity against closed forms."""

import math

import torch

from navlearn import wgs84
from navlearn.mechanization.gravity_correction import bend, nodes_of, picked, spread, spread_rate

SLOPE = 3.1e-6


def _corrected(dt: torch.Tensor, slope: torch.Tensor, push: torch.Tensor, passes: int):
    """Return way and rate at the ends for an acceleration that grows by ``push`` per second."""
    nodes = nodes_of(dt)
    middles = torch.cumsum(dt, -1) - 0.5 * dt
    at_nodes = picked(push.view(3, 1, 1) * middles, nodes.stride)
    found = bend(at_nodes, slope, nodes.step, passes)
    count = dt.shape[-1]
    return spread(found, nodes.at_end, count), spread_rate(found, nodes.at_end, count)


def test_height_follows_the_hyperbolic_sine():
    dt = torch.full((1, 7001), 0.05, dtype=torch.float64)
    dt[0, 100:200] = 0.0
    slope = torch.zeros(3, 3, 1, 1, dtype=torch.float64)
    slope[2, 2] = SLOPE
    way, rate = _corrected(dt, slope, torch.tensor((0.0, 0.0, 1e-4), dtype=torch.float64), 6)
    t, k = torch.cumsum(dt, -1)[0], math.sqrt(SLOPE)
    expected = 1e-4 * (torch.sinh(k * t) / k - t) / k**2
    assert float((way[2, 0] - expected).abs().max()) < 1e-5 * float(expected.max())
    expected = 1e-4 * (torch.cosh(k * t) - 1.0) / k**2
    assert float((rate[2, 0] - expected).abs().max()) < 1e-5 * float(expected.max())
    assert float(way[:2].abs().max()) == 0.0


def test_what_is_pushed_north_of_the_axis_turns_with_the_coriolis_force():
    dt = torch.full((1, 4000), 0.1, dtype=torch.float64)
    still = torch.zeros(3, 3, 1, 1, dtype=torch.float64)
    way, rate = _corrected(dt, still, torch.tensor((1e-3, 0.0, 0.0), dtype=torch.float64), 4)
    t = float(dt.sum())
    # v̇_y = −2 ω v_x with v_x = 1e-3 t²/2
    expected = -wgs84.EARTH_RATE * 1e-3 * t**3 / 3.0
    assert abs(float(rate[1, 0, -1]) / expected - 1.0) < 1e-3
    assert abs(float(way[0, 0, -1]) / (1e-3 * t**3 / 6.0) - 1.0) < 1e-3
