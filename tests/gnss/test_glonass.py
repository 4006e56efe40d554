"""GLONASS: forces from a potential, an integration in space, and the way back."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.gnss.ephemeris import GlonassEphemeris
from navlearn.gnss.glonass import glonass_acceleration, glonass_state

Array = NDArray[np.float64]
GM, RADIUS, J2, SPIN = 3.986004418e14, 6378136.0, 1.08262575e-3, 7.292115e-5
# R18 on 29 June 2023, 11:15 UTC, as broadcast
POSITION = (10541157.2266, 363174.316406, 23234110.8398)
VELOCITY = (321.145057678, 3167.27161407, -191.012382507)
OTHERS = (2.79396772385e-6, -1.86264514923e-6, -9.31322574615e-7)


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def message(**changed: Tensor) -> GlonassEphemeris:
    told = GlonassEphemeris(
        tensor(386118.0),
        tensor(POSITION),
        tensor(VELOCITY),
        tensor(OTHERS),
        tensor(8.9e-5),
        tensor(1.8e-12),
    )
    return told._replace(**changed)


def potential(position: Tensor) -> Tensor:
    """Return gravity with J₂ and the centrifugal potential, m²/s²."""
    r = torch.linalg.vector_norm(position, dim=-1)
    legendre = 1.5 * (position[..., 2] / r) ** 2 - 0.5
    gravity = GM / r * (1.0 - J2 * (RADIUS / r) ** 2 * legendre)
    return gravity + 0.5 * SPIN**2 * (position[..., :2] ** 2).sum(-1)


def test_forces_are_the_gradient_of_the_potential() -> None:
    generator = torch.Generator().manual_seed(1)
    position = 1.5e7 * torch.randn(20, 3, generator=generator, dtype=torch.float64)
    velocity = 3e3 * torch.randn(20, 3, generator=generator, dtype=torch.float64)
    place = position.clone().requires_grad_()
    (slope,) = torch.autograd.grad(potential(place).sum(), place)
    spin = tensor([0.0, 0.0, SPIN]).expand(20, 3)
    expected = slope - 2.0 * torch.linalg.cross(spin, velocity) + tensor(OTHERS)
    found = glonass_acceleration(position, velocity, tensor(OTHERS).expand(20, 3))
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-10)


def test_energy_in_turning_axes_is_kept() -> None:
    told = message(acceleration=torch.zeros(3, dtype=torch.float64))
    state = glonass_state(told, told.toe + tensor([0.0, 900.0, -900.0, 7200.0]))
    jacobi = 0.5 * (state.velocity**2).sum(-1) - potential(state.position)
    torch.testing.assert_close(jacobi, jacobi[:1].expand(4), atol=1e-3, rtol=0)


def test_against_an_integration_in_space() -> None:
    """Axes that do not turn, gravity by differences of the potential, another integrator."""
    spin = np.array([0.0, 0.0, SPIN])
    start = np.array(POSITION)
    inertial = np.concatenate((start, np.array(VELOCITY) + np.cross(spin, start)))

    def newton(t: float, y: Array) -> Array:
        turn = Rotation.from_rotvec(spin * t)
        r = np.linalg.norm(y[:3])
        sine = y[2] / r
        pull = -GM / r**3 * y[:3]
        wide = 1.5 * J2 * GM * RADIUS**2 / r**5 * y[:3] * (5.0 * sine**2 - [1.0, 1.0, 3.0])
        return np.concatenate((y[3:], pull + wide + turn.apply(OTHERS)))

    times = np.array([600.0, 1200.0, 1800.0])
    path = solve_ivp(newton, (0.0, 1800.0), inertial, "DOP853", times, rtol=1e-13, atol=1e-6).y.T
    state = glonass_state(message(), 386118.0 + torch.tensor(times), longest_step=10.0)
    usual = glonass_state(message(), 386118.0 + torch.tensor(times))
    torch.testing.assert_close(usual.position, state.position, atol=1.5e-3, rtol=0)
    for k, t in enumerate(times):
        back = Rotation.from_rotvec(-spin * t)
        np.testing.assert_allclose(
            state.position[k].numpy(), back.apply(path[k, :3]), atol=1e-5, rtol=0
        )
        against_earth = back.apply(path[k, 3:] - np.cross(spin, path[k, :3]))
        np.testing.assert_allclose(state.velocity[k].numpy(), against_earth, atol=1e-7, rtol=0)


def test_at_its_own_time_the_message_stands() -> None:
    state = glonass_state(message(), tensor(386118.0))
    torch.testing.assert_close(state.position, tensor(POSITION), atol=0, rtol=0)
    torch.testing.assert_close(state.velocity, tensor(VELOCITY), atol=0, rtol=0)
    assert float(state.clock) == pytest.approx(8.9e-5 * 299792458.0)
    assert float(state.clock_rate) == pytest.approx(1.8e-12 * 299792458.0)


def test_there_and_back() -> None:
    there = glonass_state(message(), tensor(386118.0 + 1500.0))
    again = message(toe=tensor(386118.0 + 1500.0), position=there.position, velocity=there.velocity)
    back = glonass_state(again, tensor(386118.0))
    torch.testing.assert_close(back.position, tensor(POSITION), atol=2e-3, rtol=0)


def test_across_the_change_of_weeks() -> None:
    early = message(toe=tensor(604790.0))
    after = glonass_state(early, tensor(20.0))
    torch.testing.assert_close(after.position, glonass_state(early, tensor(604820.0)).position)


def test_batch_equals_loop_and_shapes_broadcast() -> None:
    t = 386118.0 + torch.linspace(-900.0, 900.0, 7, dtype=torch.float64)
    together = glonass_state(message(), t)
    assert together.position.shape == (7, 3)
    assert together.clock_rate.shape == (7,)
    for k in range(7):
        alone = glonass_state(message(), t[k])
        # alone it may take fewer, longer steps
        torch.testing.assert_close(together.position[k], alone.position, atol=2e-3, rtol=0)
        torch.testing.assert_close(together.clock[k], alone.clock)
    none = glonass_state(message(), t[:0])
    assert none.position.shape == (0, 3)


def test_streaming_code_can_script_it() -> None:
    scripted = torch.jit.script(glonass_state)(message(), tensor([387018.0]))
    torch.testing.assert_close(tuple(scripted), tuple(glonass_state(message(), tensor([387018.0]))))


def test_velocity_is_the_derivative() -> None:
    t = tensor([386118.0, 386718.0])

    def position(at: Tensor) -> Tensor:
        return glonass_state(message(), at).position

    _, moved = torch.func.jvp(position, (t,), (torch.ones_like(t),))
    torch.testing.assert_close(moved, glonass_state(message(), t).velocity, atol=1e-5, rtol=0)


def test_gradients_to_the_message() -> None:
    t = tensor(386718.0)

    def scaled(position: Tensor, velocity: Tensor, acceleration: Tensor) -> tuple[Tensor, Tensor]:
        told = message(
            position=1e7 * position, velocity=1e3 * velocity, acceleration=1e-6 * acceleration
        )
        state = glonass_state(told, t)
        return state.position / 1e7, state.velocity / 1e3

    inputs = [
        (tensor(values) / scale).requires_grad_()
        for values, scale in ((POSITION, 1e7), (VELOCITY, 1e3), (OTHERS, 1e-6))
    ]
    assert torch.autograd.gradcheck(scaled, inputs, eps=1e-6, atol=1e-6)


def test_a_time_must_be_finite() -> None:
    with pytest.raises(ShapeError, match="no finite time"):
        glonass_state(message(), tensor([386118.0, float("nan")]))


@pytest.mark.parametrize("step", [0.0, -60.0, float("nan")])
def test_a_step_must_be_positive(step: float) -> None:
    with pytest.raises(ShapeError, match=r"longest_step is .* expected a positive number"):
        glonass_state(message(), tensor(386118.0), longest_step=step)
