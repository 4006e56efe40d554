"""Tilt against known attitudes, its streaming form, and SciPy's filter."""

import math

import pytest
import torch
from scipy import signal

from navlearn import attitude
from navlearn.errors import ConfigError
from navlearn.mechanization import TiltOptions, tilt_from_specific_force
from navlearn.mechanization.low_pass import low_pass_over_time
from navlearn.mechanization.tilt import tilt_angles
from navlearn.mechanization.tilt_filter import TiltFilter

GRAVITY = torch.tensor(9.81, dtype=torch.float64)


def _noise(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def test_tilt_of_a_parked_car_is_its_attitude():
    pitch = torch.tensor([0.0, 0.1, -0.2, 0.1], dtype=torch.float64)
    roll = torch.tensor([0.0, 0.05, 0.1, -0.3], dtype=torch.float64)
    C_lb = attitude.matrix_from_angles(torch.full_like(pitch, 1.1), pitch, roll)
    f_b = C_lb.mT @ torch.tensor([0.0, 0.0, 9.81], dtype=torch.float64)
    found = tilt_angles(f_b[:, 1], f_b[:, 0], GRAVITY)
    torch.testing.assert_close(found.pitch, pitch, rtol=0, atol=1e-12)
    torch.testing.assert_close(found.roll, roll, rtol=0, atol=1e-12)
    assert found.clamped.sum() == 0


@pytest.mark.parametrize("method", ["shen2010", "static"])
def test_acceleration_and_turn_of_a_level_car_are_no_tilt(method):
    # speeding up at 2 m/s² and turning left: f_y = a, f_x = -v ω
    length, dt = 400, 0.1
    t = (torch.arange(length, dtype=torch.float64) + 0.5) * dt
    speed, yaw_rate = 2.0 * t, torch.full_like(t, 0.05)
    options = TiltOptions(method=method)
    found = tilt_from_specific_force(
        torch.full_like(t, 2.0),
        -speed * yaw_rate,
        speed,
        yaw_rate,
        torch.full_like(t, dt),
        GRAVITY,
        options,
    )
    if method == "shen2010":
        # the first sample has no difference yet; its step has died away after 10 time constants
        assert found.pitch[200:].abs().max() < 1e-5
        assert found.roll.abs().max() < 1e-12
    else:
        assert found.pitch[-1].item() == pytest.approx(math.asin(2.0 / 9.81), abs=1e-12)
        assert found.roll[-1].item() > 0.3


def test_forces_beyond_gravity_are_clamped_counted_and_keep_gradients_finite():
    f_y = torch.tensor([1.0, 12.0, -15.0, 0.0], dtype=torch.float64, requires_grad=True)
    f_x = torch.tensor([0.0, 0.0, 0.0, 30.0], dtype=torch.float64, requires_grad=True)
    zero, dt = torch.zeros(4, dtype=torch.float64), torch.ones(4, dtype=torch.float64)
    options = TiltOptions(method="static", time_constant=0.0)
    found = tilt_from_specific_force(f_y, f_x, zero, zero, dt, GRAVITY, options)
    assert found.clamped.tolist() == [0.0, 1.0, 1.0, 1.0]
    assert found.pitch[1].item() == pytest.approx(math.pi / 2, abs=1e-5)
    (found.pitch.sum() + found.roll.sum()).backward()
    assert torch.isfinite(f_y.grad).all()
    assert torch.isfinite(f_x.grad).all()


@pytest.mark.parametrize(
    "options",
    [
        TiltOptions(),
        TiltOptions(sections=3, time_constant=0.3),
        TiltOptions(method="static"),
        TiltOptions(time_constant=0.0),
    ],
)
def test_streaming_equals_over_time(options):
    f_y, f_x, speed, yaw_rate = _noise(4, 2, 61).unbind(0)
    dt = 0.02 + 0.2 * _noise(2, 61).abs()
    dt[0, 50:] = 0.0
    gravity = GRAVITY.expand(2)
    over_time = tilt_from_specific_force(
        f_y, f_x, speed, yaw_rate, dt, gravity.unsqueeze(-1), options
    )
    streaming = torch.jit.script(TiltFilter(options))(f_y, f_x, speed, yaw_rate, dt, gravity)
    eager = TiltFilter(options)(f_y, f_x, speed, yaw_rate, dt, gravity)
    for a, b, c in zip(over_time, streaming, eager, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-13)
        assert torch.equal(b, c)
    held = over_time.pitch[0, 49:]
    torch.testing.assert_close(held, held[:1].expand(12), rtol=0, atol=1e-14)


def test_low_pass_equals_scipy_and_passes_gradcheck():
    values, dt, tau = _noise(3, 500), 0.1, 0.7
    keep = math.exp(-dt / tau)
    first = values[:, :1].numpy()
    expected = values.numpy()
    for _ in range(2):
        expected, _ = signal.lfilter([1.0 - keep], [1.0, -keep], expected, axis=-1, zi=keep * first)
    found = low_pass_over_time(values, torch.full_like(values, dt), tau, 2)
    torch.testing.assert_close(found, torch.from_numpy(expected), rtol=0, atol=1e-13)
    short, steps = values[:, :9].clone().requires_grad_(), torch.full((3, 9), dt).double()
    assert torch.autograd.gradcheck(
        lambda x, d: low_pass_over_time(x, d, tau, 2), (short, steps.requires_grad_())
    )


def test_force_and_acceleration_are_delayed_alike():
    # a car on the level whose speed swings: the tilt stays near zero though the filter is slow
    t = (torch.arange(3000, dtype=torch.float64) + 0.5) * 0.01
    speed, f_y = 10.0 - torch.cos(2.0 * t), 2.0 * torch.sin(2.0 * t)
    zero = torch.zeros_like(t)
    found = tilt_from_specific_force(f_y, zero, speed, zero, zero + 0.01, GRAVITY)
    # the first sample has no difference yet; its step dies away
    assert found.pitch[2000:].abs().max() < 1e-5
    late = tilt_from_specific_force(f_y, zero, speed.roll(10), zero, zero + 0.01, GRAVITY)
    assert late.pitch[2000:].abs().max() > 1e-2


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"method": "dynamic"}, "shen2010"),
        ({"time_constant": -1.0}, "0 s or more"),
        ({"time_constant": math.inf}, "0 s or more"),
        ({"sections": 0}, "1 or more"),
    ],
)
def test_options_refuse_with_advice(wrong, word):
    with pytest.raises(ConfigError, match=word):
        TiltOptions(**wrong)
