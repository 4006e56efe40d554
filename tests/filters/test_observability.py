"""Observability against linear-systems theory: which motion tells which error of an INS, or a RISS.

The error dynamics here are the φ-angle equations in ENU, written down once more from their
derivation; the expected null spaces are those in closed form ([Rhee2004], [GoshenMeskin1992]).
"""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.attitude import matrix_from_angles
from navlearn.errors import ConfigError, ShapeError
from navlearn.filters.degree_of_observability import (
    degree_of_observability,
    direction_in_words,
    main_components,
    normalized_covariance,
)
from navlearn.filters.observability import (
    hidden_parts,
    left_of_states,
    observability_matrix,
    observability_rank,
    unobservable,
)
from navlearn.filters.scan import LinearSteps, filter_in_turn

LAT, G, EARTH = 0.75, 9.8, (7.292e-5, 6.37e6)
STILL_AND_FLAT = (0.0, math.inf)  # an Earth that neither turns nor is round
NAMES = [
    *("east", "north", "up", "v_east", "v_north", "v_up", "phi_east", "phi_north", "phi_up"),
    *("gyro_bias_x", "gyro_bias_y", "gyro_bias_z"),
    *("accel_bias_x", "accel_bias_y", "accel_bias_z"),
]
SIGMAS = torch.tensor(
    [*[5.0] * 3, *[0.5] * 3, 0.01, 0.01, 0.1, *[5e-4] * 3, *[0.05] * 3], dtype=torch.float64
)
NOISE = torch.tensor([*[2.0] * 3, *[0.1] * 3], dtype=torch.float64)


def cross(v: Tensor) -> Tensor:
    x, y, z = v.tolist()
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)


def vector(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def earth_rate(size: float) -> Tensor:
    return vector(0.0, size * math.cos(LAT), size * math.sin(LAT))


def transport_rate(v_l: Tensor, R: float) -> Tensor:
    return vector(-v_l[1] / R, v_l[0] / R, v_l[0] * math.tan(LAT) / R)


def dynamics(
    azimuth: float, forward: float, lateral: float, speed: float, earth: tuple[float, float]
) -> Tensor:
    """F of a level car: position, velocity, attitude φ, gyro and accelerometer bias."""
    rate, R = earth
    C = matrix_from_angles(vector(azimuth), vector(0.0), vector(0.0))[0]
    f_l, v_l = C @ vector(lateral, forward, G), C @ vector(0.0, speed, 0.0)
    ie = earth_rate(rate)
    el = transport_rate(v_l, R)
    by_velocity = torch.zeros(3, 3, dtype=torch.float64)  # how velocity errors turn the frame
    by_velocity[0, 1], by_velocity[1, 0], by_velocity[2, 0] = -1 / R, 1 / R, math.tan(LAT) / R
    F = torch.zeros(15, 15, dtype=torch.float64)
    F[0:3, 3:6] = torch.eye(3)
    F[3:6, 3:6] = -cross(2.0 * ie + el) + cross(v_l) @ by_velocity
    F[5, 2] = 2.0 * G / R
    F[3:6, 6:9] = -cross(f_l)
    F[3:6, 12:15] = -C
    F[6:9, 3:6] = -by_velocity
    F[6:9, 6:9] = -cross(ie + el)
    F[6:9, 9:12] = -C
    return F


def transitions(
    *segments: tuple[int, float, float, float, float],
    states: int = 15,
    earth: tuple[float, float] = EARTH,
) -> Tensor:
    """Φ of every second: segments of (seconds, forward, lateral acceleration, speed, turn rate).

    Solved in axes that turn with the car: a polygon would tell what a curve does not.
    """
    azimuth, found = 0.4, []
    for seconds, forward, lateral, speed, rate in segments:
        turning = torch.block_diag(*[cross(vector(0.0, 0.0, -rate))] * 3, torch.zeros(6, 6))
        for _ in range(seconds):
            F = dynamics(azimuth + 0.5 * rate, forward, lateral, speed, earth)
            before, middle, after = (axes(azimuth + x * rate) for x in (0.0, 0.5, 1.0))
            phi = after @ torch.matrix_exp(middle.T @ F @ middle - turning) @ before.T
            found.append(phi[:states, :states])
            azimuth += rate
    return torch.stack(found)


def axes(azimuth: float) -> Tensor:
    """Return what turns errors of position, velocity and attitude from the car into ENU."""
    C_lb = matrix_from_angles(vector(azimuth), vector(0.0), vector(0.0))[0]
    return torch.block_diag(C_lb, C_lb, C_lb, torch.eye(6, dtype=torch.float64))


def fixes(count: int, states: int = 15, velocity: bool = True) -> Tensor:
    return torch.eye(states, dtype=torch.float64)[: 6 if velocity else 3].expand(count, -1, -1)


def observed(phi: Tensor, velocity: bool = True, form: str = "total", tolerance: float = 1e-9):
    n = phi.shape[-1]
    H = fixes(phi.shape[-3], n, velocity).expand(*phi.shape[:-2], -1, -1)
    matrix = observability_matrix(phi, H, form=form)
    noise = NOISE[: H.shape[-2]]
    return observability_rank(matrix, SIGMAS[:n], noise=noise, tolerance=tolerance)


REST = (20, 0.0, 0.0, 0.0, 0.0)
STEADY = (20, 0.0, 0.0, 15.0, 0.0)
SPEED_UP = (8, 2.0, 0.0, 15.0, 0.0)
BRAKE = (8, -2.0, 0.0, 15.0, 0.0)
TURN = (16, 0.0, 1.5, 15.0, 0.1)


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize(
    ("segments", "rank"),
    [
        ((REST,), 12),
        ((STEADY,), 12),
        ((SPEED_UP,), 12),  # one constant force tells no more than rest
        ((STEADY, SPEED_UP), 14),
        ((STEADY, SPEED_UP, STEADY, BRAKE), 14),  # all along one line
        ((STEADY, TURN), 15),
        ((SPEED_UP, TURN), 15),
    ],
)
def test_rank_of_fifteen_states_by_motion(segments, rank, velocity) -> None:
    assert int(observed(transitions(*segments), velocity).rank) == rank


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize(
    ("segments", "rank"),
    [((REST,), 11), ((STEADY, SPEED_UP), 14), ((TURN,), 12), ((STEADY, TURN), 15)],
)
def test_rank_on_an_earth_that_tells_nothing(segments, rank, velocity) -> None:
    """Earth rate tells the biases of level gyros apart from nothing else: one rank at rest."""
    assert int(observed(transitions(*segments, earth=STILL_AND_FLAT), velocity).rank) == rank


def test_a_steady_curve_is_as_constant_as_rest_to_the_car() -> None:
    """Any rotation hides that turns with the car, behind biases of gyros and accelerometers."""
    found = observed(transitions(TURN, earth=STILL_AND_FLAT))
    hidden = torch.zeros(15, 3, dtype=torch.float64)
    hidden[6:9] = axes(0.4)[:3, :3]
    hidden[9:12] = -cross(vector(0.0, 0.0, -0.1))
    hidden[12:15] = -cross(vector(1.5, 0.0, G))
    assert_same_span(unobservable(found), hidden / SIGMAS.unsqueeze(1))
    # what the Earth adds to that in a quarter of a minute is one clear direction, not three
    values = observed(transitions(TURN)).singular_values
    assert float(values[12] / values[0]) > 3e-6
    assert float(values[13] / values[0]) < 1e-7


def test_at_rest_the_three_hidden_combinations_are_those_in_closed_form() -> None:
    """Any small rotation hides behind the biases that make up for it."""
    found = observed(transitions(REST))
    C = matrix_from_angles(vector(0.4), vector(0.0), vector(0.0))[0]
    f_l, w = vector(0.0, 0.0, G), earth_rate(EARTH[0])
    hidden = torch.zeros(15, 3, dtype=torch.float64)
    hidden[6:9] = torch.eye(3)
    hidden[9:12] = -C.T @ cross(w)
    hidden[12:15] = -C.T @ cross(f_l)
    assert_same_span(unobservable(found), hidden / SIGMAS.unsqueeze(1))


def test_straight_acceleration_leaves_only_the_rotation_about_the_road() -> None:
    """Where all forces differ along the road, φ along it and its biases stay hidden: no azimuth."""
    found = observed(transitions(STEADY, SPEED_UP))
    C = matrix_from_angles(vector(0.4), vector(0.0), vector(0.0))[0]
    phi, f_l = C @ vector(0.0, 1.0, 0.0), vector(0.0, 0.0, G)
    hidden = torch.zeros(15, 1, dtype=torch.float64)
    hidden[6:9, 0] = phi
    v_l = C @ vector(0.0, 15.0, 0.0)
    w = earth_rate(EARTH[0]) + transport_rate(v_l, EARTH[1])
    hidden[9:12, 0] = -C.T @ torch.linalg.cross(w, phi)
    hidden[12:15, 0] = -C.T @ torch.linalg.cross(f_l, phi)
    assert_same_span(unobservable(found), hidden / SIGMAS.unsqueeze(1))
    torch.testing.assert_close(hidden_parts(found), unobservable(found)[:, 0] ** 2)
    words = direction_in_words(unobservable(found)[:, 0], NAMES)
    assert "phi up" not in words
    assert "accel bias x" in words  # roll hides behind the transversal accelerometer


def assert_same_span(found: Tensor, expected: Tensor) -> None:
    assert found.shape == expected.shape
    basis = torch.linalg.qr(expected).Q
    assert float((found - basis @ (basis.T @ found)).abs().max()) < 1e-6


@pytest.mark.parametrize(
    ("segments", "earth", "rank"),
    [
        ((REST,), STILL_AND_FLAT, 8),
        ((REST,), EARTH, 9),  # gyrocompassing
        ((STEADY,), STILL_AND_FLAT, 8),
        ((STEADY, SPEED_UP), STILL_AND_FLAT, 9),
        ((TURN,), STILL_AND_FLAT, 9),
    ],
)
def test_without_biases_azimuth_hides_until_the_car_accelerates(segments, earth, rank) -> None:
    found = observed(transitions(*segments, states=9, earth=earth))
    assert int(found.rank) == rank
    if rank == 8:
        assert main_components(unobservable(found)[:, 0], NAMES[:9]) == [
            ("phi_up", pytest.approx(1.0, abs=1e-5))
        ]


def test_a_mems_gyro_feels_no_earth_rate() -> None:
    """What can be told at rest at all is not told in practice; a short burst of power tells it."""
    at_rest = observed(transitions((60, 0.0, 0.0, 0.0, 0.0)))
    assert float(at_rest.left[-3:].min()) == 1.0
    azimuth = NAMES.index("phi_up")
    for segments, low, high in (((REST,), 0.99, 1.01), ((REST, SPEED_UP, BRAKE), 0.0, 0.15)):
        phi = transitions(*segments)
        left = information_left(phi)
        np.testing.assert_allclose(left_of_states(observed(phi)).numpy(), left, rtol=1e-9)
        assert low < left[azimuth] < high
        # accelerometer biases across the road stay behind the tilt either way
        assert left[NAMES.index("accel_bias_x")] > 0.85
    left = information_left(transitions(REST, SPEED_UP, TURN, BRAKE))
    assert left[NAMES.index("accel_bias_x")] < 0.5


def information_left(phi: Tensor) -> np.ndarray:
    """Deviation at the start given all fixes, as a part of that before: least squares in full."""
    P = torch.diag(SIGMAS**2)
    rows = observability_matrix(phi, fixes(phi.shape[0])) / NOISE.repeat(phi.shape[0]).unsqueeze(1)
    scaled = rows * SIGMAS
    left = np.linalg.inv(np.eye(15) + (scaled.T @ scaled).numpy())
    return np.sqrt(np.diag(left) * np.diag(P.numpy())) / SIGMAS.numpy()


def test_hidden_parts_add_up_to_what_is_hidden() -> None:
    found = observed(torch.stack([transitions(REST), transitions(STEADY)]))
    assert found.rank.tolist() == [12, 12]
    torch.testing.assert_close(hidden_parts(found).sum(-1), vector(3.0, 3.0))
    assert float(hidden_parts(found)[:, :6].max()) < 1e-12


@pytest.mark.parametrize("segments", [(REST,), (STEADY, SPEED_UP), (STEADY, TURN)])
def test_stripped_form_has_the_rank_of_the_total_one(segments) -> None:
    phi = transitions(*segments)
    assert int(observed(phi).rank) == int(observed(phi, form="stripped").rank)
    assert observability_matrix(phi, fixes(len(phi)), form="stripped").shape == (
        len(phi) * 15 * 6,
        15,
    )


def test_total_form_is_what_the_measurements_are_of_the_start() -> None:
    g = torch.Generator().manual_seed(3)
    phi = torch.randn(2, 4, 3, 3, generator=g, dtype=torch.float64)
    H = torch.randn(2, 4, 2, 3, generator=g, dtype=torch.float64)
    x = torch.randn(2, 3, generator=g, dtype=torch.float64)
    told, now = [], x
    for k in range(4):
        now = torch.einsum("bij,bj->bi", phi[:, k], now)
        told.append(torch.einsum("bij,bj->bi", H[:, k], now))
    found = torch.einsum("bij,bj->bi", observability_matrix(phi, H), x)
    torch.testing.assert_close(found, torch.cat(told, 1))


def test_what_is_left_is_the_kalman_filters_covariance() -> None:
    """Without process noise, the window's information and the filter say the same."""
    phi, n = transitions(STEADY, TURN), 15
    zero = torch.zeros(len(phi), n, dtype=torch.float64)
    steps = LinearSteps(
        phi,
        zero,
        torch.zeros(len(phi), n, n, dtype=torch.float64),
        fixes(len(phi)),
        (NOISE**2).expand(len(phi), -1),
        torch.zeros(len(phi), 6, dtype=torch.float64),
    )
    end = filter_in_turn(zero[0], torch.diag(SIGMAS**2), steps).covariance[-1]
    found = observed(phi)
    at_start = found.directions @ torch.diag(found.left**2) @ found.directions.T
    moved = torch.linalg.multi_dot(list(phi.flip(0)))
    expected = moved @ (SIGMAS * at_start * SIGMAS.unsqueeze(1)) @ moved.T
    sigma = end.diagonal().sqrt()
    torch.testing.assert_close(
        end / torch.outer(sigma, sigma), expected / torch.outer(sigma, sigma), atol=1e-6, rtol=0.0
    )


def test_fewer_rows_than_states_leave_directions() -> None:
    phi = torch.eye(3, dtype=torch.float64).expand(1, 3, 3)
    H = torch.tensor([[[0.0, 2.0, 0.0]]], dtype=torch.float64)
    found = observability_rank(observability_matrix(phi, H), vector(1.0, 3.0, 1.0))
    assert int(found.rank) == 1
    torch.testing.assert_close(found.singular_values, vector(6.0, 0.0, 0.0))
    assert float(unobservable(found)[1].abs().max()) == 0.0


def test_normalised_covariance_by_hand() -> None:
    P0 = torch.diag(vector(4.0, 0.01))
    P = torch.tensor([[[1.0, 0.05], [0.05, 0.04]]], dtype=torch.float64)
    found = normalized_covariance(P, P0)
    torch.testing.assert_close(
        found.against_start[0], torch.tensor([[0.25, 0.25], [0.25, 4.0]], dtype=torch.float64)
    )
    torch.testing.assert_close(found.share[0], found.against_start[0] * 2.0 / 4.25)
    degree = degree_of_observability(found)
    assert float(degree.share.sum()) == pytest.approx(2.0)
    rebuilt = degree.directions[0] @ torch.diag(degree.against_start[0]) @ degree.directions[0].T
    torch.testing.assert_close(rebuilt, found.against_start[0])
    assert degree.directions[0, 1, 1] > 0.9
    assert direction_in_words(degree.directions[0, :, 1], ["a_b", "c"]) == "c 1.00"


def test_eigenvalues_are_ordered_and_their_directions_have_a_sign() -> None:
    g = torch.Generator().manual_seed(1)
    root = torch.randn(5, 7, 4, 4, generator=g, dtype=torch.float64)
    P = root @ root.transpose(-1, -2)
    degree = degree_of_observability(normalized_covariance(P, P[:, 0]))
    assert bool((degree.share.diff(dim=-1) >= 0.0).all())
    assert bool(((degree.share >= 0.0) & (degree.share <= 4.0 + 1e-12)).all())
    assert bool((degree.directions.amax(-2) >= -degree.directions.amin(-2)).all())
    ratio = degree.against_start / degree.share
    torch.testing.assert_close(ratio, ratio[..., :1].expand_as(ratio))


def test_the_share_alone_misleads() -> None:
    """An azimuth that drifts fourfold still loses share to a position that drifts faster."""
    P0 = torch.diag(vector(1.0, 0.01))
    P = torch.stack((torch.diag(vector(1.0, 0.01)), torch.diag(vector(400.0, 0.04))))
    found = normalized_covariance(P, P0)
    assert float(found.against_start[1, 1, 1] / found.against_start[0, 1, 1]) == pytest.approx(4.0)
    assert float(found.share[1, 1, 1] / found.share[0, 1, 1]) < 0.05


def test_directions_in_words() -> None:
    names = ["azimuth", "gyro_bias_z", "east", "north"]
    words = direction_in_words(vector(0.93, -0.31, 0.1, 0.05), names)
    assert words == "azimuth 0.93, gyro bias z −0.31"
    assert main_components(vector(0.5, 0.5, 0.5, 0.5), names, most=2) == [
        ("azimuth", 0.5),
        ("gyro_bias_z", 0.5),
    ]


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: observability_matrix(torch.eye(3), torch.eye(3)), ShapeError, "expected"),
        (
            lambda: observability_matrix(torch.zeros(0, 3, 3), torch.zeros(0, 1, 3)),
            ShapeError,
            "K at least 1",
        ),
        (
            lambda: observability_matrix(torch.zeros(2, 3, 3), torch.zeros(2, 1, 3), form="whole"),
            ConfigError,
            "total or stripped",
        ),
        (
            lambda: observability_rank(torch.eye(2), vector(1.0, 0.0)),
            ShapeError,
            "known exactly",
        ),
        (
            lambda: observability_rank(torch.eye(2), vector(1.0, 1.0), noise=vector(1.0, 1.0, 1.0)),
            ShapeError,
            "one per row",
        ),
        (
            lambda: unobservable(
                observability_rank(torch.eye(2).double().expand(4, 2, 2), vector(1.0, 1.0))
            ),
            ShapeError,
            "one at a time",
        ),
        (
            lambda: normalized_covariance(torch.eye(2), torch.eye(2)),
            ShapeError,
            "expected",
        ),
        (
            lambda: normalized_covariance(torch.zeros(3, 2, 2), torch.diag(vector(1.0, 0.0))),
            ShapeError,
            r"state \[1\]",
        ),
        (lambda: direction_in_words(vector(1.0), ["a", "b"]), ShapeError, "2 names"),
    ],
)
def test_wrong_input_is_told(call, error, words) -> None:
    with pytest.raises(error, match=words):
        call()
