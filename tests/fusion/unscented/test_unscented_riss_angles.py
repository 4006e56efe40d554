"""The unscented filter of a RISS car where an azimuth or a longitude is wrapped."""

import math
from dataclasses import replace

import pytest
import torch

from navlearn.filters.unscented import UnscentedOptions
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.filters_of import riss_filter
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measurements import Kind, Verdict
from navlearn.fusion.noise_options import InitialOptions
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf
from navlearn.fusion.unscented.prediction import predicted, predicted_in_turn, rooted
from navlearn.mechanization.options import RissOptions
from navlearn.states import FixTiming, GnssFix, NavState, RissSample

POINTS = UnscentedOptions()


def run(options, d, method="exact", **changes):
    with torch.no_grad():
        belief = initial_belief(options, d.start)._replace(**changes)
        return riss_filter(options)(belief, d.samples, d.fixes, d.timing, method=method)


def apart(a, b):
    """Largest distance between two trajectories or states, m."""
    return max(float(x.abs().max()) for x in enu_between(*a[:3], *b[:3]))


def unscented(options, points=POINTS, **changes):
    return replace(options, unscented=points, **changes)


@pytest.mark.parametrize("course", [False, True])
def test_an_azimuth_near_180_degrees(make_drive, course):
    """Only differences of azimuth count: turned by a whole turn nothing changes, and a start at
    179° finds a car that drives at −179°."""
    d = make_drive(seconds=6, rate=5)
    options = unscented(EkfOptions(velocity=not course, course=course))
    turned = d.start._replace(azimuth=d.start.azimuth + 2.0 * math.pi)
    a, b = run(options, d), run(options, d, state=turned)
    assert apart(a.trajectory, b.trajectory) < 1e-9
    torch.testing.assert_close(
        b.trajectory.azimuth - a.trajectory.azimuth,
        torch.full_like(a.trajectory.azimuth, 2.0 * math.pi),
    )
    # a straight drive at −179°, believed to be at +179°
    south = torch.full((1,), math.radians(-179.0), dtype=torch.float64)
    straight, fixes = driven(south, 6, 5)
    begin = d.start._replace(azimuth=south + math.radians(358.0))
    timing = FixTiming(d.timing.index, d.timing.delay)
    options = unscented(options, gate=GateOptions(probability=1.0))
    options = replace(options, mechanization=RissOptions(dimensions=2, earth_rate=False))
    belief = initial_belief(options, begin)
    with torch.no_grad():
        found = riss_filter(options)(belief, straight, fixes, timing)
    end = float(found.belief.state.azimuth[0, -1])
    assert math.remainder(end - float(south), 2.0 * math.pi) == pytest.approx(0.0, abs=2e-3)
    assert end == pytest.approx(math.radians(181.0), abs=2e-3)


def driven(azimuth, seconds, rate, lon=-1.33):
    """A straight drive at 15 m/s without errors, and a fix each second."""
    length = seconds * rate
    zero = torch.zeros(1, length, dtype=torch.float64)
    samples = RissSample(zero + 1.0 / rate, zero, zero + 15.0, *[zero] * 5)
    way = 15.0 * torch.arange(1, seconds + 1, dtype=torch.float64).unsqueeze(0)
    one = torch.ones_like(way)
    start = (0.77 * one, lon * one, 100.0 * one)
    east, north = torch.sin(azimuth).unsqueeze(-1), torch.cos(azimuth).unsqueeze(-1)
    place = shift_geodetic(*start, way * east, way * north, 0.0 * way)
    return samples, GnssFix(
        *place, 15.0 * east * one, 15.0 * north * one, 0.0 * one,
        *[1.0 * one] * 3, 0.1 * one, one, one,
    )  # fmt: skip


def test_a_drive_across_the_antimeridian(make_drive):
    """Fixes whose longitudes are wrapped to ±180° on the way."""
    east = torch.full((1,), math.radians(90.0), dtype=torch.float64)
    lon = math.pi - 40.0 / (6.38e6 * math.cos(0.77))
    samples, fixes = driven(east, 6, 5, lon)
    wrapped = fixes._replace(lon=torch.remainder(fixes.lon + math.pi, 2.0 * math.pi) - math.pi)
    assert float(wrapped.lon[0, 0]) > 0.0 > float(wrapped.lon[0, -1])
    options = unscented(EkfOptions(mechanization=RissOptions(dimensions=2)))
    start = NavState(*(torch.full((1,), x, dtype=torch.float64) for x in (0.77, lon, 100.0, 1.5)))
    timing = make_drive(seconds=6, rate=5).timing
    found = []
    for told in (fixes, wrapped):
        with torch.no_grad():
            found.append(
                riss_filter(options)(initial_belief(options, start), samples, told, timing)
            )
    assert apart(found[0].trajectory, found[1].trajectory) < 1e-8
    assert bool((found[1].verdict[..., Kind.POSITION] == int(Verdict.ACCEPTED)).all())


def test_points_lie_the_right_way_round_the_antimeridian(make_drive):
    """Doubt of ten kilometres reaches across; the position's mean and spread do not notice."""
    samples, _ = driven(torch.zeros(1, dtype=torch.float64), 2, 5)
    ends = []
    for lon in (math.pi - 1e-6, 0.5):
        start = NavState(*(torch.full((1,), x, dtype=torch.float64) for x in (0.77, lon, 1.0, 0.4)))
        ukf = LooselyCoupledUkf(unscented(EkfOptions(initial=InitialOptions(position=1e4))))
        line = ukf.laid_out(samples, None, FixTiming(torch.tensor([[9]]), torch.zeros(1, 1)))
        begin = rooted(initial_belief(ukf.options, start))
        for way in (predicted, predicted_in_turn):
            with torch.no_grad():
                end = way(ukf, ukf.weights, begin, ukf.block(line, 0))
            ends.append((end.belief.state.lon - lon, end.belief.covariance))
    for a, b in zip(ends[:2], ends[2:], strict=True):
        torch.testing.assert_close(a[0], b[0], rtol=1e-7, atol=1e-14)
        torch.testing.assert_close(a[1], b[1], rtol=1e-7, atol=1e-9)
