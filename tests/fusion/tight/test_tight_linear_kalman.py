"""On a car of constant velocity under far satellites: the textbook's linear Kalman filter."""

import itertools
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.frames import ecef_from_geodetic, enu_between, enu_from_ecef_matrix, shift_geodetic
from navlearn.fusion.blocks import cut, gathered
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Kind, Rows
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import ClockOptions, RangeGateOptions, TightEkfOptions
from navlearn.fusion.tight.vehicle import Antenna, VehicleAhead, VehicleLine
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.states import FixTiming, GnssFix, NavState, RissSample, SatelliteRanges, Trajectory

PUSH = 0.05
"""Acceleration noise, m/s/√s."""

ORIGIN = (0.8, 0.2, 300.0)


class ConstantVelocity:
    """A point that keeps its velocity; position and velocity are its six states."""

    names = ("east", "north", "up", "v_east", "v_north", "v_up")
    rows = Rows((), (), (), len(Kind))
    limits: tuple[float, ...] = ()
    gate = GateOptions()
    anchor = None
    company = ()
    unscented = None

    def laid_out(
        self, samples: RissSample, fixes: GnssFix | None, timing: FixTiming
    ) -> VehicleLine:
        blocks = cut(samples.dt, timing.index, 10.0)
        elapsed = (gathered(samples.dt, blocks.gather) * blocks.used).sum(-1)
        late = gathered(timing.delay, blocks.fix.clamp(min=0))
        return VehicleLine(blocks, elapsed, late * (blocks.fix >= 0))

    def all_blocks(self, line: VehicleLine) -> Tensor:
        return line.line

    def block(self, line: VehicleLine, k: int) -> Tensor:
        return line.line[:, k]

    def predicted(self, belief: Belief, block: Tensor) -> VehicleAhead:
        one, dt = torch.eye(3, dtype=torch.float64), block[..., None, None]
        zero = 0.0 * one
        over = torch.cat((torch.cat((one, zero), 1), torch.cat((zero, one), 1)), 0)
        up = torch.cat((torch.cat((zero, one), 1), torch.cat((zero, zero), 1)), 0)
        q = PUSH**2 * torch.cat(
            (
                torch.cat((one * dt**3 / 3.0, one * dt**2 / 2.0), -1),
                torch.cat((one * dt**2 / 2.0, one * dt), -1),
            ),
            -2,
        )
        way = belief.velocity_offset * block.unsqueeze(-1)
        there = shift_geodetic(*belief.state[:3], *way.unbind(-1))
        end = belief._replace(state=NavState(*there, belief.state.azimuth))
        return VehicleAhead(end, over + dt * up, q)

    def predicted_in_turn(self, belief: Belief, block: Tensor) -> VehicleAhead:
        return self.predicted(belief, block)

    def measured(self, belief: Belief, block: Tensor) -> Measured:
        nothing = belief.velocity_offset[..., :0]
        H = nothing.unsqueeze(-1).expand(*nothing.shape, 6)
        return Measured(nothing, H, nothing, block.new_zeros((*block.shape, len(Kind))))

    def antenna(self, belief: Belief, block: Tensor, delay: Tensor) -> Antenna:
        back = -delay.unsqueeze(-1) * belief.velocity_offset
        place = shift_geodetic(*belief.state[:3], *back.unbind(-1))
        one = torch.eye(3, dtype=torch.float64).expand(*delay.shape, 3, 3)
        late = -delay[..., None, None] * one
        v = belief.velocity_offset
        moving = torch.cat((0.0 * one, one), -1)
        return Antenna(*place, v, torch.cat((one, late), -1), moving, 0.0 * v)

    def moved(self, belief: Belief, correction: Tensor, block: Tensor) -> Belief:
        place = shift_geodetic(*belief.state[:3], *correction[..., :3].unbind(-1))
        return belief._replace(
            state=NavState(*place, belief.state.azimuth),
            velocity_offset=belief.velocity_offset + correction[..., 3:],
        )

    def opened(self, verdict: Tensor, found: Measured, innovation: Tensor) -> Tensor:
        raise AssertionError("nothing of its own to open")

    def path(self, start: Belief, after: Belief, line: VehicleLine) -> Trajectory:
        state = after.state
        return Trajectory(*state, *after.velocity_offset.unbind(-1))

    def difference(self, belief: Belief, other: Belief, block: Tensor) -> Tensor:
        way = enu_between(*belief.state[:3], *other.state[:3])
        return torch.cat((torch.stack(way, -1), belief.velocity_offset - other.velocity_offset), -1)


def point(velocity: tuple[float, float, float], sigma: Tensor) -> Belief:
    lat, lon, height = (torch.tensor(x, dtype=torch.float64) for x in ORIGIN)
    none = torch.zeros(0, dtype=torch.float64)
    state = NavState(lat, lon, height, torch.zeros_like(lat))
    v = torch.tensor(velocity, dtype=torch.float64)
    return Belief(state, none, v, torch.diag(sigma**2), none, torch.zeros(len(Kind)).double())


def far_ranges(count: int, seed: int) -> tuple[SatelliteRanges, Tensor, Tensor]:
    """Ranges of five fixed far satellites of two systems, told by a linear model of ten states
    (position, velocity, bias, drift, offset, 1), and the unit vectors."""
    g = torch.Generator().manual_seed(seed)
    angle = torch.tensor([0.2, 1.5, 2.7, 4.1, 5.3], dtype=torch.float64)
    high = torch.tensor([0.5, 1.1, 0.4, 0.8, 0.6], dtype=torch.float64)
    level = torch.cos(high)
    unit = torch.stack((level * angle.sin(), level * angle.cos(), high.sin()), -1)
    here = tuple(torch.tensor(x, dtype=torch.float64) for x in ORIGIN)
    distance = 9.2e7
    satellite = ecef_from_geodetic(*here) + distance * unit @ enu_from_ecef_matrix(*here[:2])
    t = torch.arange(1.0, count + 1, dtype=torch.float64).unsqueeze(-1)
    way = t.unsqueeze(-1) * torch.tensor([0.3, -0.2, 0.05], dtype=torch.float64)
    system = torch.tensor([0, 1, 0, 1, 0])
    clock = 40.0 + 2.5 * t + 7.0 * system
    shape = (count, 5)
    noise = 2.0 * torch.randn(shape, generator=g, dtype=torch.float64)
    slow = 0.1 * torch.randn(shape, generator=g, dtype=torch.float64)
    ranges = distance - (way * unit).sum(-1) + clock + noise
    rates = -(torch.tensor([0.3, -0.2, 0.05], dtype=torch.float64) * unit).sum(-1) + 2.5 + slow
    one = torch.ones(shape, dtype=torch.float64)
    there = (torch.rand(shape, generator=g) < 0.7).double()
    rated = (torch.rand(shape, generator=g) < 0.7).double()
    return (
        SatelliteRanges(
            satellite.expand(*shape, 3),
            torch.zeros(*shape, 3, dtype=torch.float64),
            ranges,
            rates,
            high.expand(shape),
            45.0 * one,
            2.0 * one,
            0.1 * one,
            system.expand(shape),
            there,
            rated,
        ),
        unit,
        distance * torch.ones(5, dtype=torch.float64),
    )


def textbook(ranges: SatelliteRanges, unit: Tensor, distance: Tensor, P: np.ndarray) -> Any:
    """Every line as in a textbook: states position, velocity, bias, drift, offset."""
    x = np.concatenate((np.zeros(3), [0.1, 0.0, 0.0], np.zeros(3)))
    F, Q = np.eye(9), np.zeros((9, 9))
    F[:3, 3:6] = np.eye(3)
    F[6, 7] = 1.0
    for i in range(3):
        Q[np.ix_([i, i + 3], [i, i + 3])] = PUSH**2 * np.array([[1 / 3, 0.5], [0.5, 1.0]])
    Q[6:8, 6:8] = 0.1**2 * np.diag([1.0, 0.0]) + 0.2**2 * np.array([[1 / 3, 0.5], [0.5, 1.0]])
    Q[8, 8] = 0.005**2
    u, d = unit.numpy(), distance.numpy()
    found = []
    for m in range(len(ranges.pseudorange)):
        x, P = F @ x, F @ P @ F.T + Q
        rows, z, r = [], [], []
        for s in range(5):
            if ranges.has_range[m, s] > 0.5:
                h = np.zeros(9)
                h[:3], h[6], h[8] = -u[s], 1.0, float(ranges.system[m, s])
                rows.append(h)
                z.append(float(ranges.pseudorange[m, s]) - d[s])
                r.append(4.0)
            if ranges.has_rate[m, s] > 0.5:
                h = np.zeros(9)
                h[3:6], h[7] = -u[s], 1.0
                rows.append(h)
                z.append(float(ranges.range_rate[m, s]))
                r.append(0.01)
        if rows:
            H, R = np.array(rows), np.diag(r)
            S = H @ P @ H.T + R
            K = P @ H.T @ np.linalg.inv(S)
            x = x + K @ (np.array(z) - H @ x)
            P = (np.eye(9) - K @ H) @ P
        found.append((x.copy(), P.copy()))
    return found


def test_the_linear_filter_of_the_textbook() -> None:
    count = 25
    ranges, unit, distance = far_ranges(count, 3)
    told = RangeNoiseOptions(
        orbit_clock=0.0,
        ionosphere=0.0,
        troposphere=0.0,
        multipath=0.0,
        rate_floor=0.0,
        rate_multipath=0.0,
    )
    options = TightEkfOptions(
        range_noise=told,
        clock=ClockOptions(initial_bias=100.0, initial_drift=10.0, initial_offset=20.0),
        gate=RangeGateOptions(probability=1.0),
    )
    vehicle = ConstantVelocity()
    ekf = TightEkf(vehicle, options, 2)
    sigma = torch.tensor([5.0, 5.0, 5.0, 0.5, 0.5, 0.5], dtype=torch.float64)
    start = point((0.1, 0.0, 0.0), sigma)
    one, zero = torch.ones(count, dtype=torch.float64), torch.zeros(count, dtype=torch.float64)
    samples = RissSample(one, *(zero,) * 7)
    timing = FixTiming(torch.arange(count), zero)
    history = ekf(start, samples, ranges, timing)
    P = np.diag(np.concatenate((sigma.numpy(), [100.0, 10.0, 20.0])) ** 2)
    origin = tuple(torch.tensor(x, dtype=torch.float64) for x in ORIGIN)
    for m, (x, want) in enumerate(textbook(ranges, unit, distance, P)):
        belief = history.belief
        place = torch.stack(enu_between(*(c[m] for c in belief.vehicle.state[:3]), *origin))
        got = torch.cat((place, belief.vehicle.velocity_offset[m], belief.clock[m]))
        # curvature of the Earth and of the satellites' spheres over ten metres
        np.testing.assert_allclose(got.numpy(), x, atol=2e-4)
        np.testing.assert_allclose(belief.covariance[m].numpy(), want, atol=1e-5, rtol=1e-5)
    assert float(history.belief.covariance[-1, 0, 0]) < 1.5


def test_every_satellite_takes_some_of_what_is_unknown() -> None:
    sigma = torch.full((6,), 3.0, dtype=torch.float64)
    one, zero = torch.ones(20, dtype=torch.float64), torch.zeros(20, dtype=torch.float64)
    timing = FixTiming(torch.arange(20), zero)
    ekf = TightEkf(ConstantVelocity(), TightEkfOptions(), 2)
    unknown = []
    for satellites in range(6):
        ranges, _, _ = far_ranges(20, 5)
        keep = (torch.arange(5) < satellites).double()
        ranges = ranges._replace(has_range=keep.expand(20, 5), has_rate=keep.expand(20, 5))
        start = point((0.3, -0.2, 0.05), sigma)
        history = ekf(start, RissSample(one, *(zero,) * 7), ranges, timing)
        P = history.belief.covariance
        assert bool((torch.linalg.eigvalsh(P) > 0.0).all())
        assert int(history.resets.sum()) == 0
        unknown.append(float(P[-1].diagonal()[:3].sum()))
    # without any, nothing but the model: velocity's variance grows into position's
    free = 3.0 * (9.0 + 9.0 * 400.0 + PUSH**2 * 8000.0 / 3.0)
    assert unknown[0] == pytest.approx(free, rel=1e-9)
    assert all(more > fewer for more, fewer in itertools.pairwise(unknown))
    assert unknown[5] < 0.01 * free
