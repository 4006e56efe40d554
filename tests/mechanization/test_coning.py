"""Coning and sculling: closed forms of a coning body, fine integration, streaming, padding."""

import math

import pytest
import torch

from navlearn import attitude
from navlearn.errors import ShapeError
from navlearn.mechanization import coning
from navlearn.mechanization.coning import Interval, coning_sculling, coning_sculling_step

HALF_ANGLE, FREQUENCY = 0.02, 2.0 * math.pi * 2.0


def _coning_rates(dt: float, count: int) -> torch.Tensor:
    """Return mean rates of a body whose z axis goes round a cone, in closed form, (count, 3)."""
    t = torch.arange(count + 1, dtype=torch.float64) * dt
    size = FREQUENCY * math.sin(HALF_ANGLE)
    sine = -torch.diff(torch.cos(FREQUENCY * t)) / (FREQUENCY * dt)
    cosine = torch.diff(torch.sin(FREQUENCY * t)) / (FREQUENCY * dt)
    slow = torch.full_like(sine, -2.0 * FREQUENCY * math.sin(HALF_ANGLE / 2.0) ** 2)
    return torch.stack((-size * sine, size * cosine, slow), -1)


def _attitude(t: float) -> torch.Tensor:
    half = HALF_ANGLE / 2.0
    turn = FREQUENCY * t
    return torch.tensor(
        (
            math.cos(half),
            math.sin(half) * math.cos(turn),
            math.sin(half) * math.sin(turn),
            0.0,
        ),
        dtype=torch.float64,
    )


def _drift(dt: float, duration: float, compensated: bool) -> float:
    """Return by how much the attitude of the coning body is wrong in the end, rad."""
    omega = _coning_rates(dt, round(duration / dt))
    times = torch.full(omega.shape[:1], dt, dtype=torch.float64)
    rotation, _ = coning_sculling(omega, torch.zeros_like(omega), times)
    q = _attitude(0.0)
    for turn in attitude.quaternion_from_rotation_vector(
        rotation if compensated else omega * dt
    ).unbind(0):
        q = attitude.quaternion_multiply(q, turn)
    back = _attitude(duration) * torch.tensor((1.0, -1.0, -1.0, -1.0), dtype=torch.float64)
    return 2.0 * float(attitude.quaternion_multiply(q, back)[1:].norm())


def test_coning_leaves_an_error_of_fourth_order_in_the_interval():
    plain = [_drift(dt, 10.0, compensated=False) for dt in (0.02, 0.01)]
    better = [_drift(dt, 10.0, compensated=True) for dt in (0.02, 0.01)]
    assert 3.8 < plain[0] / plain[1] < 4.2
    # the first interval, which has none before it, leaves a part that does not grow
    assert 10.0 < better[0] / better[1] < 18.0
    assert better[1] < 0.01 * plain[1]


def _errors(scale: float, steps: int = 2000) -> list[float]:
    """Return errors of rotation and velocity, compensated and not, on a linear course."""
    h = 0.02 * scale / steps
    middle = (torch.arange(-round(1.5 * steps), steps, dtype=torch.float64) + 0.5) * h
    rate = torch.tensor((0.4, -0.9, 0.7)) + torch.tensor((-9.0, 17.0, 4.0)) * middle.unsqueeze(-1)
    force = torch.tensor((3.0, -2.0, 9.0)) + torch.tensor((40.0, 60.0, 20.0)) * middle.unsqueeze(-1)
    now = middle > 0.0
    means = [torch.stack((x[~now].mean(0), x[now].mean(0))) for x in (rate, force)]
    dt = torch.tensor((1.5, 1.0), dtype=torch.float64) * 0.02 * scale
    rotation, velocity = coning_sculling(*means, dt)

    q = torch.tensor((1.0, 0.0, 0.0, 0.0), dtype=torch.float64)
    total = torch.zeros(3, dtype=torch.float64)
    for half, a in zip(
        attitude.quaternion_from_rotation_vector(0.5 * rate[now] * h), force[now], strict=True
    ):
        q = attitude.quaternion_multiply(q, half)
        total = total + attitude.matrix_from_quaternion(q) @ a * h
        q = attitude.quaternion_multiply(q, half)
    plain = means[0][1] * dt[1], coning_sculling_step(means[0][1], means[1][1], dt[1])[1]
    turns = [attitude.quaternion_from_rotation_vector(x) for x in (rotation[1], plain[0])]
    return [
        *(float((x - q).norm()) for x in turns),
        *(float((x - total).norm()) for x in (velocity[1], plain[1])),
    ]


def test_rate_and_force_that_change_linearly_are_integrated_to_third_order():
    coarse, fine = _errors(1.0), _errors(0.5)
    coned, not_coned, sculled, not_sculled = (a / b for a, b in zip(coarse, fine, strict=True))
    assert 7.0 < not_coned < 9.0
    assert 7.0 < not_sculled < 9.0
    assert coned > 14.0
    assert sculled > 14.0


def test_a_force_in_a_body_that_turns_steadily_is_all_but_exact():
    rate, force, dt = (torch.tensor(x, dtype=torch.float64) for x in ((0, 0, 0.8), (5, 0, 2), 0.5))
    _, velocity = coning_sculling_step(rate, force, dt)
    angle = 0.4
    expected = (5 / 0.8 * math.sin(angle), 5 / 0.8 * (1 - math.cos(angle)), 1.0)
    torch.testing.assert_close(
        velocity, torch.tensor(expected, dtype=torch.float64), rtol=0, atol=1e-9
    )


def _record(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(4)
    omega, f = torch.randn(2, 2, count, 3, generator=generator, dtype=torch.float64).unbind(0)
    dt = 0.005 + 0.01 * torch.rand(2, count, generator=generator, dtype=torch.float64)
    dt[0, 7] = 0.0
    dt[1, count - 5 :] = 0.0
    return omega, 10.0 * f, dt


@pytest.mark.parametrize("previous", [True, False])
def test_streaming_equals_the_whole_record(monkeypatch, previous):
    monkeypatch.setattr(coning, "BLOCK_ELEMENTS", 40)
    omega, f, dt = _record(150)
    before = Interval(omega[:, 0], f[:, 0], dt[:, 0]) if previous else None
    rotation, velocity = coning_sculling(omega[:, 1:], f[:, 1:], dt[:, 1:], before)
    step = torch.jit.script(coning_sculling_step)
    for k in range(1, 150):
        turn, push = step(omega[:, k], f[:, k], dt[:, k], before)
        torch.testing.assert_close(turn, rotation[:, k - 1], rtol=0, atol=1e-17)
        torch.testing.assert_close(push, velocity[:, k - 1], rtol=0, atol=1e-16)
        before = Interval(omega[:, k], f[:, k], dt[:, k])


def test_padding_gives_zeros_and_spoils_no_neighbour():
    omega, f, dt = _record(40)
    rotation, velocity = coning_sculling(omega, f, dt)
    assert float(rotation[dt == 0.0].abs().max()) == 0.0
    assert float(velocity[dt == 0.0].abs().max()) == 0.0
    alone, _ = coning_sculling_step(omega[0, 8], f[0, 8], dt[0, 8])
    torch.testing.assert_close(rotation[0, 8], alone, rtol=0, atol=0)


def test_increments_pass_gradcheck_and_an_empty_record_gives_none():
    omega, f, dt = (x[:, 5:10].clone().requires_grad_() for x in _record(40))
    whole = dt.detach().clamp(min=0.01).requires_grad_()
    assert torch.autograd.gradcheck(coning_sculling, (omega, f, whole))
    assert coning_sculling(omega[:, :0], f[:, :0], dt[:, :0])[0].shape == (2, 0, 3)


def test_wrong_shapes_are_refused_with_advice():
    omega, f, dt = _record(10)
    with pytest.raises(ShapeError, match=r"forces \(2, 3, 10\).*put x, y, z last"):
        coning_sculling(omega, f.transpose(-1, -2), dt)
