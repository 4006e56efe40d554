"""Angles, matrices and quaternions against each other, SciPy and plain cases."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from navlearn import attitude


def _angles(n: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    u = torch.rand(3, n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return (
        (2.0 * u[0] - 1.0) * math.pi * 0.999,
        (u[1] - 0.5) * math.pi * 0.99,
        (2.0 * u[2] - 1.0) * math.pi * 0.999,
    )


def _rotation(azimuth, pitch, roll) -> Rotation:
    """Azimuth about down, then pitch about the turned x axis, then roll about the turned y axis."""
    return Rotation.from_euler("ZXY", torch.stack((-azimuth, pitch, roll), -1).numpy())


def test_matrix_equals_scipy_composition():
    angles = _angles(50)
    expected = torch.from_numpy(_rotation(*angles).as_matrix())
    torch.testing.assert_close(attitude.matrix_from_angles(*angles), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("angles", "body", "local"),
    [
        (
            (math.pi / 2, 0.0, 0.0),
            (0.0, 1.0, 0.0),
            (1.0, 0.0, 0.0),
        ),  # heading east: forward is east
        ((math.pi / 2, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),  # and right is south
        ((0.0, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, math.cos(0.1), math.sin(0.1))),  # nose up
        ((0.0, 0.0, 0.1), (1.0, 0.0, 0.0), (math.cos(0.1), 0.0, -math.sin(0.1))),  # right side down
    ],
)
def test_signs(angles, body, local):
    C_lb = attitude.matrix_from_angles(*torch.tensor(angles, dtype=torch.float64))
    found = C_lb @ torch.tensor(body, dtype=torch.float64)
    torch.testing.assert_close(found, torch.tensor(local, dtype=torch.float64), rtol=0, atol=1e-15)


def test_angles_return_from_matrix_and_from_quaternion():
    angles = _angles(200, seed=1)
    for C_lb in (
        attitude.matrix_from_angles(*angles),
        attitude.matrix_from_quaternion(attitude.quaternion_from_angles(*angles)),
    ):
        for found, given in zip(attitude.angles_from_matrix(C_lb), angles, strict=True):
            torch.testing.assert_close(found, given, rtol=0, atol=1e-11)


def test_angles_of_a_vertical_nose_stay_finite():
    zero = torch.zeros(1, dtype=torch.float64)
    C_lb = attitude.matrix_from_angles(zero + 0.3, zero + math.pi / 2, zero) * (1.0 + 1e-15)
    pitch = attitude.angles_from_matrix(C_lb)[1]
    assert pitch.item() == pytest.approx(math.pi / 2, abs=1e-7)


def test_quaternion_product_equals_scipy():
    first, second = _rotation(*_angles(50)), _rotation(*_angles(50, seed=2))
    to_tensor = lambda r: torch.from_numpy(r.as_quat(scalar_first=True))  # noqa: E731
    found = attitude.quaternion_multiply(to_tensor(first), to_tensor(second))
    expected = torch.from_numpy((first * second).as_matrix())
    torch.testing.assert_close(attitude.matrix_from_quaternion(found), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-12, 0.9e-4, 1.1e-4, 0.3, 3.1])
def test_rotation_vector_equals_scipy_at_any_size(size):
    vector = size * torch.tensor([[0.6, 0.0, 0.8], [-0.36, 0.48, 0.8]], dtype=torch.float64)
    expected = torch.from_numpy(Rotation.from_rotvec(vector.numpy()).as_quat(scalar_first=True))
    found = attitude.quaternion_from_rotation_vector(vector)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-15)


def test_rotation_vector_differentiates_at_zero():
    vector = torch.tensor([[0.0, 0.0, 0.0], [0.2, -0.1, 0.4]], dtype=torch.float64)
    assert torch.autograd.gradcheck(
        attitude.quaternion_from_rotation_vector, vector.requires_grad_()
    )


def test_wrapped_angles_keep_their_direction():
    angle = torch.linspace(-50.0, 50.0, 2001, dtype=torch.float64)
    wrapped = attitude.wrap_angle(angle)
    assert wrapped.min() >= -math.pi
    assert wrapped.max() < math.pi
    torch.testing.assert_close(torch.sin(wrapped), torch.sin(angle), rtol=0, atol=1e-13)
    torch.testing.assert_close(torch.cos(wrapped), torch.cos(angle), rtol=0, atol=1e-13)
    assert attitude.wrap_angle(torch.tensor(math.pi, dtype=torch.float64)).item() == -math.pi


def test_functions_script():
    angles = _angles(5)
    for function in (attitude.matrix_from_angles, attitude.quaternion_from_angles):
        assert torch.equal(torch.jit.script(function)(*angles), function(*angles))
    C_lb = attitude.matrix_from_angles(*angles)
    for found, expected in zip(
        torch.jit.script(attitude.angles_from_matrix)(C_lb),
        attitude.angles_from_matrix(C_lb),
        strict=True,
    ):
        assert torch.equal(found, expected)
    q = attitude.quaternion_from_angles(*angles)
    assert torch.equal(
        torch.jit.script(attitude.quaternion_multiply)(q, q), attitude.quaternion_multiply(q, q)
    )
    assert torch.equal(
        torch.jit.script(attitude.matrix_from_quaternion)(q), attitude.matrix_from_quaternion(q)
    )
    v = q[..., 1:]
    assert torch.equal(
        torch.jit.script(attitude.quaternion_from_rotation_vector)(v),
        attitude.quaternion_from_rotation_vector(v),
    )
    assert torch.equal(torch.jit.script(attitude.wrap_angle)(v * 9), attitude.wrap_angle(v * 9))


def test_angles_differentiate():
    angles = tuple(a.requires_grad_() for a in _angles(4, seed=3))
    assert torch.autograd.gradcheck(attitude.matrix_from_angles, angles)
    assert torch.autograd.gradcheck(attitude.quaternion_from_angles, angles)
    round_trip = lambda *a: attitude.angles_from_matrix(attitude.matrix_from_angles(*a))  # noqa: E731
    assert torch.autograd.gradcheck(round_trip, angles)


def test_quaternion_of_a_matrix_equals_scipy_and_returns_the_matrix():
    generator = torch.Generator().manual_seed(5)
    given = torch.randn(300, 4, generator=generator, dtype=torch.float64)
    half_turns = torch.eye(4, dtype=torch.float64)[1:]  # scalar zero: the hard ones
    given = torch.cat((given / given.norm(dim=-1, keepdim=True), half_turns))
    matrix = attitude.matrix_from_quaternion(given)
    found = attitude.quaternion_from_matrix(matrix)
    expected = torch.from_numpy(
        Rotation.from_matrix(matrix.numpy()).as_quat(canonical=True, scalar_first=True)
    )
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-14)
    torch.testing.assert_close(attitude.matrix_from_quaternion(found), matrix, rtol=0, atol=1e-14)
    assert torch.autograd.gradcheck(
        attitude.quaternion_from_matrix, matrix[:300:60].clone().requires_grad_()
    )


def test_angles_return_from_a_quaternion():
    angles = _angles(100, seed=2)
    quaternion = attitude.quaternion_from_angles(*angles)
    for found, given in zip(attitude.angles_from_quaternion(quaternion), angles, strict=True):
        torch.testing.assert_close(found, given, rtol=0, atol=1e-11)
