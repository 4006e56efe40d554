"""Increments over windows: closed forms, the loop, Jacobians, noise, padding, gradients."""

import math

import pytest
import torch
from torch import Tensor

from navlearn.attitude import (
    matrix_from_quaternion,
    quaternion_from_rotation_vector,
    quaternion_multiply,
)
from navlearn.errors import ShapeError
from navlearn.mechanization import preintegration_window
from navlearn.mechanization.coning import velocity_at_start
from navlearn.mechanization.preintegration import (
    Preintegrated,
    preintegrate,
    preintegrate_increments,
)

float64 = torch.float64


def samples(windows: int, n: int, dt: float = 0.01) -> tuple[Tensor, Tensor, Tensor]:
    """Return a car on a rough, winding road; every window differs."""
    t = torch.arange(windows * n, dtype=float64).view(windows, n, 1) * dt
    axis = torch.arange(3, dtype=float64)
    omega = 0.5 * torch.sin(0.7 * t + axis) + 0.2 * torch.cos(6.0 * t * (1.0 + axis) + 2.0)
    force = torch.cat((2.0 * torch.sin(0.9 * t), 3.0 * torch.cos(1.3 * t), 9.8 + 0.0 * t), -1)
    return omega, force, torch.full((windows, n), dt, dtype=float64)


def in_turn(omega: Tensor, force: Tensor, dt: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Integrate one window sample by sample with fifty smaller steps each."""
    q = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=float64)
    v, p = torch.zeros(3, dtype=float64), torch.zeros(3, dtype=float64)
    for w, f, h in zip(omega, force, dt, strict=True):
        step = h / 50
        half = quaternion_from_rotation_vector(0.5 * w * step)
        for _ in range(50):
            q = quaternion_multiply(q, half)
            more = matrix_from_quaternion(q) @ f * step
            p, v = p + (v + 0.5 * more) * step, v + more
            q = quaternion_multiply(q, half)
    return q, v, p


def test_constant_rate_about_the_force_has_a_closed_form() -> None:
    T, n, rate, g = 2.0, 40, 0.6, 9.8
    omega = torch.tensor([0.0, 0.0, rate], dtype=float64).expand(n, 3)
    force = torch.tensor([0.0, 1.5, g], dtype=float64).expand(n, 3)
    pre = preintegrate(omega, force, torch.full((n,), T / n, dtype=float64))
    half, turned = 0.5 * rate * T, rate * T
    expected = torch.tensor([math.cos(half), 0.0, 0.0, math.sin(half)], dtype=float64)
    torch.testing.assert_close(pre.rotation, expected, rtol=0.0, atol=1e-14)
    circle = 1.5 / rate * torch.tensor([math.cos(turned) - 1.0, math.sin(turned)], dtype=float64)
    torch.testing.assert_close(pre.velocity[:2], circle, rtol=1e-6, atol=0.0)
    way = torch.tensor([math.sin(turned) - turned, 1.0 - math.cos(turned)], dtype=float64)
    torch.testing.assert_close(pre.position[:2], 1.5 / rate**2 * way, rtol=1e-5, atol=0.0)
    assert float(pre.velocity[2]) == pytest.approx(g * T, rel=1e-14)
    assert float(pre.position[2]) == pytest.approx(0.5 * g * T * T, rel=1e-14)
    assert float(pre.duration) == pytest.approx(T)


def test_equals_fine_integration_sample_by_sample() -> None:
    omega, force, dt = samples(2, 100)
    pre = preintegrate(omega, force, dt)
    for k in range(2):
        q, v, p = in_turn(omega[k], force[k], dt[k])
        torch.testing.assert_close(pre.rotation[k], q, rtol=0.0, atol=1e-12)
        torch.testing.assert_close(pre.velocity[k], v, rtol=0.0, atol=3e-8)
        torch.testing.assert_close(pre.position[k], p, rtol=0.0, atol=3e-8)


def test_increments_and_means_agree() -> None:
    omega, force, dt = samples(3, 50)
    rotation = omega * dt.unsqueeze(-1)
    speed = velocity_at_start(rotation, force * dt.unsqueeze(-1))
    means = preintegrate(omega, force, dt, gyro_random_walk=0.01, scale_factors=True)
    increments = preintegrate_increments(
        rotation, speed, dt, gyro_random_walk=0.01, scale_factors=True
    )
    for name in ("rotation", "velocity", "position", "covariance"):
        torch.testing.assert_close(
            getattr(increments, name), getattr(means, name), rtol=1e-6, atol=1e-8
        )
    torch.testing.assert_close(increments.by_sensor, means.by_sensor, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 7, 100, 101])
def test_one_window_at_a_time_and_padding_change_nothing(n: int) -> None:
    omega, force, dt = samples(3, n)
    both = preintegrate(omega, force, dt, gyro_random_walk=0.01, accel_random_walk=0.1)
    more = torch.nn.functional.pad(omega, (0, 0, 0, 4), value=5.0)
    longer = preintegrate(
        more,
        torch.nn.functional.pad(force, (0, 0, 0, 4), value=-3.0),
        torch.nn.functional.pad(dt, (0, 4)),
        gyro_random_walk=0.01,
        accel_random_walk=0.1,
    )
    for k in range(3):
        alone = preintegrate(
            omega[k], force[k], dt[k], gyro_random_walk=0.01, accel_random_walk=0.1
        )
        for one, many, padded in zip(alone, both, longer, strict=True):
            torch.testing.assert_close(one, many[k], rtol=1e-12, atol=1e-13)
            torch.testing.assert_close(padded[k], many[k], rtol=1e-12, atol=1e-13)


def logarithm(q: Tensor) -> Tensor:
    return 2.0 * torch.atan2(q[1:].norm(), q[0]) * q[1:] / q[1:].norm()


def test_jacobians_are_the_derivatives_of_the_increments() -> None:
    omega, force, dt = samples(1, 60)
    at = torch.tensor([0.02, -0.01, 0.03, 0.2, -0.1, 0.3] + [0.01, -0.02, 0.03] * 2, dtype=float64)
    pre = increments_of(omega[0], force[0], dt[0], at)
    back = pre.rotation * torch.tensor([1.0, -1.0, -1.0, -1.0], dtype=float64)

    def errors(sensor: Tensor) -> Tensor:
        new = increments_of(omega[0], force[0], dt[0], sensor)
        turn = quaternion_multiply(new.rotation, back)
        return torch.cat((new.position, new.velocity, 2.0 * turn[1:] * torch.sign(turn[0])))

    found = torch.func.jacfwd(errors)(at)
    scale = found.abs().amax(-1, keepdim=True)
    torch.testing.assert_close(pre.by_sensor / scale, found / scale, rtol=0.0, atol=1e-4)


def increments_of(omega: Tensor, force: Tensor, dt: Tensor, sensor: Tensor) -> Preintegrated:
    gyro_bias, accel_bias, gyro_scale, accel_scale = sensor.split(3)
    return preintegrate(
        omega,
        force,
        dt,
        gyro_bias=gyro_bias,
        accel_bias=accel_bias,
        gyro_scale=gyro_scale,
        accel_scale=accel_scale,
        scale_factors=True,
    )


def test_covariance_equals_its_propagation_sample_by_sample() -> None:
    omega, force, dt = samples(1, 80)
    noise = 0.003 * (1.0 + torch.rand(1, 80, dtype=float64, generator=torch.manual_seed(1)))
    pre = preintegrate(omega, force, dt, gyro_random_walk=noise, accel_random_walk=0.05)
    q, P = torch.tensor([1.0, 0, 0, 0], dtype=float64), torch.zeros(9, 9, dtype=float64)
    eye = torch.eye(3, dtype=float64)
    for w, f, h, s in zip(omega[0], force[0], dt[0], noise[0], strict=True):
        middle = quaternion_multiply(q, quaternion_from_rotation_vector(0.5 * w * h))
        x, y, z = (matrix_from_quaternion(middle) @ f).tolist()
        cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=float64)
        F = torch.zeros(9, 9, dtype=float64)
        F[:3, 3:6], F[3:6, 6:] = eye, -cross
        G = torch.zeros(9, 9, dtype=float64)
        G[3:6, 3:6], G[6:, 6:] = 0.05**2 * eye, s**2 * eye
        Phi = torch.matrix_exp(F * h)
        halfway = torch.matrix_exp(0.5 * F * h)
        P = Phi @ P @ Phi.T + halfway @ G @ halfway.T * h
        q = quaternion_multiply(q, quaternion_from_rotation_vector(w * h))
    sigma = P.diagonal().sqrt()
    scale = sigma.unsqueeze(-1) * sigma
    torch.testing.assert_close(pre.covariance[0] / scale, P / scale, rtol=0.0, atol=2e-4)
    assert float(torch.linalg.eigvalsh(pre.covariance[0] / scale).amin()) > 0.0


def test_noise_may_be_told_once_per_window_or_per_sample() -> None:
    omega, force, dt = samples(4, 4)
    per_window = torch.tensor([0.1, 0.2, 0.3, 0.4], dtype=float64)
    found = preintegrate(
        omega, force, dt, gyro_random_walk=per_window, accel_random_walk=per_window
    )
    per_sample = preintegrate(
        omega,
        force,
        dt,
        gyro_random_walk=per_window.unsqueeze(-1).expand(4, 4),
        accel_random_walk=per_window,
    )
    torch.testing.assert_close(found.covariance, per_sample.covariance)
    for k, walk in enumerate(per_window):
        alone = preintegrate(
            omega[k], force[k], dt[k], gyro_random_walk=walk, accel_random_walk=float(walk)
        )
        torch.testing.assert_close(found.covariance[k], alone.covariance)


def test_turning_adds_its_mean_square_to_the_noise() -> None:
    omega, force, dt = samples(3, 40)
    dt[2, 30:] = 0.0
    found = preintegrate(omega, force, dt, gyro_random_walk=0.01, turn_noise=0.2)
    mean = ((omega * omega).sum(-1) * dt).sum(-1) / dt.sum(-1)
    told = preintegrate(omega, force, dt, gyro_random_walk=torch.sqrt(0.01**2 + 0.2**2 * mean))
    torch.testing.assert_close(found.covariance, told.covariance)
    assert float(found.covariance[0, 8, 8]) > 2.0 * 0.01**2 * 0.4


def test_a_few_windows_at_a_time_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    omega, force, dt = (x.view(2, 3, *x.shape[1:]) for x in samples(6, 20))
    bias = torch.tensor([0.01, -0.02, 0.03], dtype=float64)
    noise = torch.tensor([[0.1], [0.2]], dtype=float64).expand(2, 3)
    per_sample = noise.unsqueeze(-1).expand(2, 3, 20)

    def run() -> Preintegrated:
        return preintegrate(
            omega,
            force,
            dt,
            gyro_random_walk=per_sample,
            accel_random_walk=noise,
            gyro_bias=bias * torch.ones(2, 3, 1, dtype=float64),
            accel_scale=bias,
            scale_factors=True,
        )

    whole = run()
    monkeypatch.setattr(preintegration_window, "TOGETHER", 40)
    for one, other in zip(run(), whole, strict=True):
        torch.testing.assert_close(one, other)
    assert whole.by_sensor.shape == (2, 3, 9, 12)


@pytest.mark.slow
def test_covariance_is_that_of_many_noisy_records() -> None:
    draws, n = 20000, 25
    omega, force, dt = samples(1, n, dt=0.04)
    gyro, accel, root = 0.01, 0.1, 0.04**0.5
    generator = torch.manual_seed(3)
    noise = torch.randn(2, draws, n, 3, dtype=float64, generator=generator) / root
    pre = preintegrate(omega, force, dt, gyro_random_walk=gyro, accel_random_walk=accel)
    many = preintegrate(omega + gyro * noise[0], force + accel * noise[1], dt.expand(draws, n))
    back = pre.rotation * torch.tensor([1.0, -1.0, -1.0, -1.0], dtype=float64)
    turn = quaternion_multiply(many.rotation, back.expand(draws, 4))
    errors = torch.cat(
        (many.position - pre.position, many.velocity - pre.velocity, 2.0 * turn[:, 1:]), -1
    )
    factor = torch.linalg.inv(torch.linalg.cholesky(pre.covariance[0]))
    found = torch.cov((errors @ factor.T).T)
    # nine unit variances: each has a deviation of √(2/draws) = 0.01
    torch.testing.assert_close(found, torch.eye(9, dtype=float64), rtol=0.0, atol=0.05)


def test_gradients_forward_and_backward() -> None:
    generator = torch.manual_seed(0)
    omega = torch.randn(1, 5, 3, dtype=float64, generator=generator)
    force = 9.0 * torch.randn(1, 5, 3, dtype=float64, generator=generator)
    dt = 0.1 * torch.rand(1, 5, dtype=float64, generator=generator)
    dt[0, 3:] = 0.0
    omega[0, 0] = 0.0

    def run(*inputs: Tensor) -> tuple[Tensor, ...]:
        return tuple(
            preintegrate(*inputs, gyro_random_walk=0.1, accel_random_walk=0.1, scale_factors=True)
        )

    inputs = [x.requires_grad_() for x in (omega, force, dt)]
    assert torch.autograd.gradcheck(run, inputs, check_forward_ad=True)


def test_shapes_that_do_not_go_together_are_refused() -> None:
    omega, force, dt = samples(2, 10)
    with pytest.raises(ShapeError, match=r"expected \(..., n, 3\) twice"):
        preintegrate(omega, force[:1], dt)
    with pytest.raises(ShapeError, match="do not go together"):
        preintegrate(omega, force, dt[:, :-1])
