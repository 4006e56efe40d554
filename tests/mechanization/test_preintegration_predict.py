"""States and their errors over windows, beside the strapdown that goes sample by sample."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import (
    matrix_from_quaternion,
    quaternion_from_angles,
    quaternion_from_rotation_vector,
    quaternion_multiply,
)
from navlearn.filters.discretize import van_loan
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.preintegration import (
    Preintegrated,
    block_transition,
    predict,
    preintegrate,
    preintegrate_increments,
)
from navlearn.mechanization.strapdown import local_level_in_turn
from navlearn.states import InsState

float64 = torch.float64


def road(windows: int, n: int, dt: float = 0.01) -> tuple[Tensor, Tensor, Tensor]:
    """Return a car's means over one continuous record, cut into windows."""
    t = torch.arange(windows * n, dtype=float64).view(windows, n, 1) * dt
    axis = torch.arange(3, dtype=float64)
    omega = 0.2 * torch.sin(0.7 * t + axis) + 0.05 * torch.cos(6.0 * t * (1.0 + axis) + 2.0)
    force = torch.cat((2.0 * torch.sin(0.9 * t), 3.0 * torch.cos(1.3 * t), 9.8 + 0.0 * t), -1)
    return omega, force, torch.full((windows, n), dt, dtype=float64)


def places(count: int) -> InsState:
    """Return states all over the Earth, fast and slow, in any attitude."""
    generator = torch.manual_seed(4)
    q = torch.randn(count, 4, dtype=float64, generator=generator)
    return InsState(
        torch.linspace(-1.2, 1.3, count, dtype=float64),
        torch.linspace(-2.0, 2.0, count, dtype=float64),
        torch.linspace(-50.0, 900.0, count, dtype=float64),
        20.0 * torch.randn(count, 3, dtype=float64, generator=generator),
        q / q.norm(dim=-1, keepdim=True),
    )


def moved(state: InsState, error: Tensor) -> InsState:
    """Return a state with an error in the order of the filter added, (..., 9)."""
    r_m = earth.meridian_radius(state.lat) + state.height
    r_n = earth.prime_vertical_radius(state.lat) + state.height
    return InsState(
        state.lat + error[..., 1] / r_m,
        state.lon + error[..., 0] / (r_n * torch.cos(state.lat)),
        state.height + error[..., 2],
        state.v_l + error[..., 3:6],
        quaternion_multiply(quaternion_from_rotation_vector(error[..., 6:9]), state.q_lb),
    )


def difference(state: InsState, reference: InsState) -> Tensor:
    """Return the small error of a state, inverse of :func:`moved`, (..., 9)."""
    r_m = earth.meridian_radius(reference.lat) + reference.height
    r_n = earth.prime_vertical_radius(reference.lat) + reference.height
    back = reference.q_lb * torch.tensor([1.0, -1.0, -1.0, -1.0], dtype=float64)
    turn = quaternion_multiply(state.q_lb, back)
    return torch.cat(
        (
            ((state.lon - reference.lon) * r_n * torch.cos(reference.lat)).unsqueeze(-1),
            ((state.lat - reference.lat) * r_m).unsqueeze(-1),
            (state.height - reference.height).unsqueeze(-1),
            state.v_l - reference.v_l,
            2.0 * turn[..., 1:] * torch.sign(turn[..., :1]),
        ),
        -1,
    )


def last_of(path: InsState) -> InsState:
    return InsState(*(x[:, -1] for x in path))


@pytest.mark.parametrize(("n", "limit"), [(100, 1e-6), (500, 1e-4)])
def test_equals_strapdown_sample_by_sample(n: int, limit: float) -> None:
    omega, force, dt = road(7, n)
    start = places(7)
    rotation, velocity = coning_sculling(omega, force, dt)
    expected = last_of(local_level_in_turn(start, rotation, velocity, dt))
    found = predict(start, preintegrate_increments(rotation, velocity, dt))
    gap = difference(found, expected)
    assert float(gap[:, :6].abs().amax()) < limit
    assert float(gap[:, 6:].abs().amax()) < 1e-9


@pytest.mark.parametrize("seconds", [1.0, 5.0])
def test_a_parked_car_stays(seconds: float) -> None:
    lat = torch.tensor([-0.6, 0.0, 0.9, 1.4], dtype=float64)
    zero = torch.zeros_like(lat)
    q = quaternion_from_angles(0.7 + zero, 0.05 + zero, -0.1 + zero)
    start = InsState(lat, zero, zero + 60.0, zero.unsqueeze(-1).expand(4, 3), q)
    C_bl = matrix_from_quaternion(q).transpose(-1, -2).unsqueeze(1)
    rate = (C_bl @ earth.earth_rate_enu(lat).view(4, 1, 3, 1)).squeeze(-1)
    up = torch.nn.functional.pad(earth.normal_gravity(lat, start.height).unsqueeze(-1), (2, 0))
    force = (C_bl @ up.view(4, 1, 3, 1)).squeeze(-1)
    n = int(100 * seconds)
    dt = torch.full((4, n), 0.01, dtype=float64)
    pre = preintegrate(rate.expand(4, n, 3), force.expand(4, n, 3), dt)
    gap = difference(predict(start, pre), start)
    assert float(gap[:, :6].abs().amax()) < 1e-7
    assert float(gap[:, 6:].abs().amax()) < 1e-13


def test_new_sensor_parameters_to_first_order() -> None:
    omega, force, dt = road(5, 100)
    start = places(5)
    pre = preintegrate(omega, force, dt, scale_factors=True)
    whole = torch.tensor([4e-3, -8e-3, 4e-3, 0.1, -0.1, 0.1] + [4e-3] * 6, dtype=float64)
    gaps = []
    for change in (whole.expand(5, 12), 0.5 * whole.expand(5, 12)):
        gyro_bias, accel_bias, gyro_scale, accel_scale = change.split(3, -1)
        again = preintegrate(
            omega,
            force,
            dt,
            gyro_bias=gyro_bias,
            accel_bias=accel_bias,
            gyro_scale=gyro_scale,
            accel_scale=accel_scale,
        )
        gaps.append(difference(predict(start, pre, change), predict(start, again)).norm(dim=-1))
    assert float(gaps[0].amax()) < 5e-3
    # what the first order leaves is the square of the change
    torch.testing.assert_close(gaps[0] / gaps[1], 4.0 + 0.0 * gaps[0], rtol=0.05, atol=0.0)


def transition_by_derivative(omega: Tensor, force: Tensor, dt: Tensor, start: InsState) -> Tensor:
    at = predict(start, preintegrate(omega, force, dt))

    def errors(e: Tensor) -> Tensor:
        gyro_bias, accel_bias, gyro_scale, accel_scale = e[9:].split(3)
        pre = preintegrate(
            omega,
            force,
            dt,
            gyro_bias=gyro_bias,
            accel_bias=accel_bias,
            gyro_scale=gyro_scale,
            accel_scale=accel_scale,
        )
        return difference(predict(moved(start, e[:9]), pre), at)

    return torch.func.jacfwd(errors)(torch.zeros(21, dtype=float64))


@pytest.mark.parametrize("place", [0, 2, 3])
def test_transition_is_the_derivative_of_the_prediction(place: int) -> None:
    omega, force, dt = (x[place] for x in road(4, 100))
    start = InsState(*(x[place] for x in places(4)))
    walk = torch.zeros(13, dtype=float64)
    Phi, _ = block_transition(start, preintegrate(omega, force, dt, scale_factors=True), walk)
    expected = transition_by_derivative(omega, force, dt, start)
    # what one deviation of each error does: m, m/s, rad, biases and scales of a cheap IMU
    size = torch.tensor(
        [1.0] * 3 + [0.1] * 3 + [1e-2] * 3 + [1e-3] * 3 + [1e-1] * 3 + [1e-2] * 6, dtype=float64
    )
    assert float(((Phi[:9, :21] - expected) * size).abs().amax()) < 2e-5
    tiny = (Phi[6:9, :21] - expected[6:9]) * size
    assert float(tiny.abs().amax()) < 1e-8
    # Schuler: an error of velocity tilts the level, an error of height changes gravity
    torch.testing.assert_close(Phi[6:9, 3:6], expected[6:9, 3:6], rtol=1e-4, atol=1e-11)
    assert float(Phi[5, 2]) == pytest.approx(float(expected[5, 2]), rel=1e-2)
    torch.testing.assert_close(Phi[9:, 9:], torch.eye(13, dtype=float64))
    assert float(Phi[:, 21].abs().sum()) == 1.0


def dynamics(C: Tensor, omega: Tensor, f: Tensor) -> Tensor:
    """Return F of the φ-angle model on an Earth that is flat and stands still, (21, 21)."""
    F = torch.zeros(21, 21, dtype=float64)
    x, y, z = (C @ f).tolist()
    F[:3, 3:6] = torch.eye(3, dtype=float64)
    F[3:6, 6:9] = -torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=float64)
    F[6:9, 9:12], F[3:6, 12:15] = -C, -C
    F[6:9, 15:18], F[3:6, 18:21] = -C * omega, -C * f
    return F


def test_noise_is_van_loan_composed_sample_by_sample() -> None:
    omega, force, dt = (x[0] for x in road(1, 100))
    start = InsState(*(x[1] for x in places(4)))
    walk = torch.tensor([3e-4] * 3 + [2e-3] * 3 + [1e-4] * 6, dtype=float64)
    gyro, accel = 1e-3, 1e-2
    pre = preintegrate(
        omega, force, dt, gyro_random_walk=gyro, accel_random_walk=accel, scale_factors=True
    )
    _, found = block_transition(start, pre, walk)
    density = torch.diag(torch.cat((torch.tensor([0.0] * 3 + [accel] * 3 + [gyro] * 3), walk)) ** 2)
    P, q = torch.zeros(21, 21, dtype=float64), start.q_lb
    for w, f, h in zip(omega, force, dt, strict=True):
        middle = quaternion_multiply(q, quaternion_from_rotation_vector(0.5 * w * h))
        F = dynamics(matrix_from_quaternion(middle), w, f)
        Phi, Q = van_loan(F, density, h)
        P = Phi @ P @ Phi.T + Q
        q = quaternion_multiply(q, quaternion_from_rotation_vector(w * h))
    sigma = P.diagonal().sqrt()
    scale = sigma.unsqueeze(-1) * sigma
    gap = ((found - P) / scale).abs()
    assert float(gap[:9, :9].amax()) < 5e-3
    # rates and forces that vary enter the scale factors' columns by their mean
    assert float(gap[:15, :15].amax()) < 1e-2
    assert float(gap.amax()) < 0.15
    assert float(torch.linalg.eigvalsh(found / scale).amin()) > 0.0


@pytest.mark.parametrize("function", [predict, block_transition])
def test_scripted_equals_eager(function: Callable[..., InsState]) -> None:
    omega, force, dt = road(2, 10)
    pre: Preintegrated = preintegrate(omega, force, dt, gyro_random_walk=0.1, accel_random_walk=0.1)
    more = (torch.ones(6, dtype=float64),) if function is block_transition else ()
    change = torch.full((2, 6), 1e-3, dtype=float64)
    scripted = torch.jit.script(function)
    for a, b in zip(
        function(places(2), pre, *more, change),
        scripted(places(2), pre, *more, change),
        strict=True,
    ):
        torch.testing.assert_close(a, b, rtol=1e-14, atol=1e-16)


def test_gradients_of_the_prediction() -> None:
    omega, force, dt = road(1, 2, dt=0.1)
    start = [x.requires_grad_() for x in places(1)]
    change = torch.full((1, 6), 1e-3, dtype=float64, requires_grad=True)
    walk = torch.full((7,), 0.3, dtype=float64, requires_grad=True)

    def run(omega: Tensor, change: Tensor, walk: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        at = InsState(*state)
        pre = preintegrate(omega, force, dt, gyro_random_walk=0.1, accel_random_walk=0.1)
        found = predict(at, pre, change)
        return (1e3 * found.lat, 1e3 * found.lon, *found[2:], *block_transition(at, pre, walk))

    inputs = (omega.requires_grad_(), change, walk, *start)
    assert torch.autograd.gradcheck(run, inputs, atol=1e-6, rtol=1e-3)


def test_windows_one_after_another_stays_with_the_strapdown() -> None:
    windows, n = 10, 100
    omega, force, dt = road(windows, n)
    start = InsState(*(x[2:3] for x in places(5)))
    rotation, velocity = coning_sculling(
        *(x.flatten(0, 1).unsqueeze(0) for x in (omega, force, dt))
    )
    path = local_level_in_turn(start, rotation, velocity, dt.view(1, -1))
    laid = (rotation.view(windows, n, 3), velocity.view(windows, n, 3), dt)
    pre = preintegrate_increments(*laid)
    state = start
    for k in range(windows):
        state = predict(state, Preintegrated(*(x[k : k + 1] for x in pre)))
    assert float(difference(state, last_of(path))[:, :3].abs().amax()) < 2e-5
