"""Sigma points of a full IMU: turned on the manifold, carried and measured with axes of points."""

import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from navlearn.attitude import quaternion_from_angles
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.frames import enu_between
from navlearn.fusion.ins.composed import has_closed_form
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.fusion.tight.ins_vehicle import InsBlock, InsVehicle
from navlearn.fusion.tight.trees import block_at
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

CHOICES = {
    "9": InsEkfOptions(states=9, odometer_scale=False),
    "15": InsEkfOptions(lever_arm=(0.5, -1.2, 1.7), wheel_lever_arm=(0.1, -1.0, -0.4)),
    "21": InsEkfOptions(states=21, mounting=(0.02, -0.01, 0.03)),
    "gauss_markov": InsEkfOptions(correlation_time=60.0),
    "dahmane2022": InsEkfOptions(model="dahmane2022"),
}
POINTS = 5


def vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def belief_of(options: InsEkfOptions) -> InsBelief:
    attitude = quaternion_from_angles(*vector(0.7, 0.1, -0.05).unbind())
    state = InsState(*vector(1.05, 0.3, 500.0).unbind(), vector(12.0, 14.0, 0.3), attitude)
    known = {"gyro_bias": vector(0.01, -0.02, 0.03), "accel_bias": vector(0.1, 0.2, -0.3)}
    return initial_ins_belief(options, state, sensor=known if options.states > 9 else None)


def block_of(vehicle: InsVehicle, n: int = 40, padding: int = 0) -> InsBlock:
    """A bend of n samples with a fix at its end, batch shape (1,); intervals of no length pad."""
    one = torch.ones(1, n, 1, dtype=torch.float64)
    wave = 1.0 + 0.1 * torch.sin(torch.arange(n, dtype=torch.float64))[None, :, None]
    there = one[..., 0]
    omega, force = vector(0.05, -0.03, 0.3) * wave, vector(2.0, 1.5, 9.9) * wave
    samples = ImuSample(0.02 * there, omega, force, 18.0 * there, there, 0.0 * there)
    fix = GnssFix(*(vector(x)[None] for x in (1.05, 0.3, 500, 12, 14, 0, 1, 1, 1, 0.1, 1, 1)))
    timing = FixTiming(torch.tensor([[n - 1]]), vector(0.0)[None])
    block: InsBlock = block_at(vehicle.all_blocks(vehicle.laid_out(samples, fix, timing)), 0)
    wide = ImuSample(*(padded(x, padding) for x in block.samples))
    return block._replace(samples=wide)


def padded(channel: Tensor, count: int) -> Tensor:
    zero = torch.zeros_like(channel[:, :1]).expand(-1, count, *channel.shape[2:])
    return torch.cat((channel, zero), 1)


def points_of(vehicle: InsVehicle, block: InsBlock, scale: float = 1.0) -> tuple[InsBelief, Any]:
    """Points about a belief, batch shape (1, P), and the block with an axis of points."""
    belief = map_ins_belief(belief_of(vehicle.options), lambda x: x.expand(1, POINTS, *x.shape))
    g = torch.Generator().manual_seed(3)
    drawn = torch.randn(1, POINTS, len(vehicle.names), generator=g, dtype=torch.float64)
    sigma = belief.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    return vehicle.moved(belief, scale * sigma * drawn, block), with_points(block)


def with_points(tree: Any) -> Any:
    if isinstance(tree, Tensor):
        return tree.unsqueeze(1).expand(tree.shape[0], POINTS, *tree.shape[1:])
    return type(tree)(*map(with_points, tree))


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("padding", [0, 3])
def test_carried_is_the_prediction_without_its_linearisation(name: str, padding: int) -> None:
    vehicle = InsVehicle(CHOICES[name])
    points, block = points_of(vehicle, block_of(vehicle, padding=padding))
    carried = vehicle.carried(points, block)
    wanted = vehicle.predicted(points, block).belief
    for a, b in zip((*carried.state, *carried[1:]), (*wanted.state, *wanted[1:]), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("name", CHOICES)
@pytest.mark.parametrize("scale", [1.0, 1e-5])
def test_points_come_apart_as_they_are_carried(name: str, scale: float) -> None:
    vehicle = InsVehicle(CHOICES[name])
    alone, (points, block) = block_of(vehicle), points_of(vehicle, block_of(vehicle), scale)
    centre = map_ins_belief(belief_of(vehicle.options), lambda x: x.unsqueeze(0))
    many = map_ins_belief(centre, lambda x: x.unsqueeze(1).expand(1, POINTS, *x.shape[1:]))
    deviation = vehicle.difference(points, many, block)
    deviation = torch.cat((torch.zeros_like(deviation[:, :1]), deviation), 1)
    apart = vehicle.carried_apart(centre, deviation, alone)
    assert float(apart[:, 0].abs().max()) < 1e-16
    ends, end = vehicle.carried(points, block), vehicle.carried(centre, alone)
    end = map_ins_belief(end, lambda x: x.unsqueeze(1).expand(1, POINTS, *x.shape[1:]))
    wanted = vehicle.difference(ends, end, block)
    torch.testing.assert_close(apart[:, 1:], wanted, rtol=0.0, atol=1e-4 * scale + 4e-9)
    # what narrow points show of second order is told in more digits than a latitude has
    if scale < 1.0 and has_closed_form(vehicle.model):
        pair = torch.stack((deviation[:, 1], -deviation[:, 1]), 1)
        pair = torch.cat((torch.zeros_like(pair[:, :1]), pair), 1)
        even = vehicle.carried_apart(centre, pair, alone)[:, 1:].sum(1)
        assert float(even[:, :3].abs().max()) < 1e-9


@pytest.mark.parametrize("name", ["15", "gauss_markov"])
def test_a_block_is_its_samples(name: str) -> None:
    vehicle = InsVehicle(CHOICES[name])
    belief = map_ins_belief(belief_of(vehicle.options), lambda x: x.unsqueeze(0))
    block = block_of(vehicle)
    pieces = vehicle.in_samples(block)
    assert [piece.samples.omega_ib_b.shape for piece in pieces] == [(1, 1, 3)] * 40
    found = belief
    for piece in pieces:
        found = vehicle.carried(found, piece)
    wanted = vehicle.carried_in_turn(belief, block)
    # a bias that decays is held at its middle over a block
    assert float(vehicle.difference(found, wanted, block)[..., :9].abs().max()) < 1e-4
    assert float((found.sensor - wanted.sensor).abs().max()) < 1e-12


@pytest.mark.parametrize("name", CHOICES)
def test_carried_is_what_samples_do_in_turn(name: str) -> None:
    vehicle = InsVehicle(CHOICES[name])
    points, block = points_of(vehicle, block_of(vehicle))
    at_once, in_turn = vehicle.carried(points, block), vehicle.carried_in_turn(points, block)
    way = torch.stack(enu_between(*at_once.state[:3], *in_turn.state[:3]), -1)
    assert float(way.norm(dim=-1).max()) < 1e-3
    apart = vehicle.difference(at_once, in_turn, block)
    # biases that decay are held at their middle over a block
    assert float(apart[..., 3:9].abs().max()) < 2e-3
    torch.testing.assert_close(at_once.sensor, in_turn.sensor, rtol=1e-12, atol=0.0)
    textbook = vehicle.predicted_in_turn(points, block).belief
    for a, b in zip(in_turn.state, textbook.state, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("name", CHOICES)
def test_points_are_measured_as_each_by_itself(name: str) -> None:
    vehicle = InsVehicle(CHOICES[name])
    points, block = points_of(vehicle, block_of(vehicle))
    together = vehicle.measured(points, block)
    antenna = vehicle.antenna(points, block, vector(0.1).expand(1, POINTS))
    assert together.innovation.shape == (1, POINTS, vehicle.rows.size)
    for k in range(POINTS):
        one = map_ins_belief(points, lambda x: x[:, k])  # noqa: B023
        alone = block_at(block, k)
        for a, b in zip(together[:4], vehicle.measured(one, alone)[:4], strict=True):
            torch.testing.assert_close(a[:, k], b, rtol=1e-13, atol=1e-13)
        for a, b in zip(antenna, vehicle.antenna(one, alone, vector(0.1)), strict=True):
            torch.testing.assert_close(a[:, k], b, rtol=1e-13, atol=1e-12)


@given(
    axis=st.tuples(*(st.floats(-1.0, 1.0),) * 3),
    angle=st.floats(0.0, math.pi - 1e-6),
    turn=st.tuples(*(st.floats(-3.0, 3.0),) * 3),
)
@settings(max_examples=60, deadline=None)
def test_difference_undoes_moved_for_any_rotation(
    axis: tuple[float, ...], angle: float, turn: tuple[float, ...]
) -> None:
    vehicle = InsVehicle()
    belief = belief_of(vehicle.options)
    q_lb = quaternion_from_angles(*vector(*turn).unbind())
    belief = belief._replace(state=belief.state._replace(q_lb=q_lb))
    length = float(vector(*axis).norm())
    phi = vector(*axis) * (angle / length) if length > 1e-3 else vector(0.0, 0.0, angle)
    correction = torch.zeros(len(vehicle.names), dtype=torch.float64)
    correction[6:9] = phi
    correction[3:6] = vector(1.0, -2.0, 3.0)
    correction[9:12] = 0.01
    moved = vehicle.moved(belief, correction, None)
    torch.testing.assert_close(
        vehicle.difference(moved, belief, None), correction, rtol=0.0, atol=2e-9
    )
    back = vehicle.moved(moved, -vehicle.difference(moved, belief, None), None)
    torch.testing.assert_close((back.state.q_lb * q_lb).sum().abs(), vector(1.0)[0])
    # another library turns alike: C = exp(phi) C
    turned = Rotation.from_rotvec(phi.numpy()) * Rotation.from_quat(q_lb, scalar_first=True)
    found = Rotation.from_quat(moved.state.q_lb, scalar_first=True)
    assert (found * turned.inv()).magnitude() < 1e-9


def test_an_azimuth_turned_right_round_is_back() -> None:
    vehicle = InsVehicle()
    belief = belief_of(vehicle.options)
    correction = torch.zeros(len(vehicle.names), dtype=torch.float64)
    correction[8] = 1.75 * math.pi
    found = vehicle.difference(vehicle.moved(belief, correction, None), belief, None)
    assert float(found[8]) == pytest.approx(-0.25 * math.pi, abs=1e-12)
    correction[8] = math.pi
    found = vehicle.difference(vehicle.moved(belief, correction, None), belief, None)
    assert abs(float(found[8])) == pytest.approx(math.pi, abs=1e-9)


def test_positions_move_there_and_back() -> None:
    vehicle = InsVehicle()
    belief = belief_of(vehicle.options)
    correction = torch.zeros(len(vehicle.names), dtype=torch.float64)
    correction[:3] = vector(30.0, -40.0, 10.0)
    found = vehicle.difference(vehicle.moved(belief, correction, None), belief, None)
    torch.testing.assert_close(found, correction, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("degrees", [-350.0, -200.0, 120.0, 190.0, 311.0, 400.0])
def test_points_may_lie_further_than_half_a_turn_apart(degrees: float) -> None:
    """An azimuth of which nothing is known stays unknown: no point comes back the other way."""
    options = CHOICES["15"]
    vehicle = InsVehicle(options)
    block = block_of(vehicle, 10)
    belief = map_ins_belief(belief_of(options), lambda x: x.unsqueeze(0))
    apart = torch.zeros(1, 3, len(vehicle.names), dtype=torch.float64)
    apart[0, 1, 6:9] = math.radians(degrees) * vector(0.1, 0.2, 1.0) / vector(0.1, 0.2, 1.0).norm()
    apart[0, 2] = -apart[0, 1]
    found = vehicle.carried_apart(belief, apart, block)
    torch.testing.assert_close(found[..., 6:9], apart[..., 6:9], rtol=0.0, atol=1e-3)
