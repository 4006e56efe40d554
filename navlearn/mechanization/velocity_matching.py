"""Attitude of a car in motion, from how its GNSS velocity changes: velocity matching.

Over a window of fixes the gyros tell how the body turned and the accelerometers what was added to
its velocity, both in the body's axes; GNSS tells the same change in local level. The rotation
between both is the attitude. A first guess solves Wahba's problem by singular values
([Markley1988]) for the changes between neighbouring fixes; least squares then refine attitude,
velocity and the sensors' biases together, robust against wild fixes. Gravity tells pitch and roll;
azimuth needs a horizontal acceleration, or the course of a car that does not slip.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import angles_from_matrix, matrix_from_angles
from navlearn.mechanization.matching_model import (
    Guess,
    Prediction,
    VelocityFixes,
    Window,
    corrected,
)


@dataclass(frozen=True, kw_only=True)
class MatchingOptions:
    """What velocity matching assumes.

    Attributes:
        accel_bias_sigma: Standard deviation of each accelerometer's bias, m/s².
        course_speed: Slowest speed at which course tells azimuth, m/s.
        slip_sigma: Standard deviation of azimuth minus course of a car that drives straight, rad;
            infinite leaves azimuth to the accelerations alone.
        axle_distance: How far before or behind the rear axle the IMU may sit, m: there the car
            moves sideways in a turn.
        attitude_walk: Random walk of the attitude by the gyros' noise, rad/√s: what the least
            squares do not know of.
        passes: Most passes of the least squares.
    """

    accel_bias_sigma: float = 0.08
    course_speed: float = 4.0
    slip_sigma: float = 0.02
    axle_distance: float = 1.5
    attitude_walk: float = math.radians(0.01)
    passes: int = 8


class VelocityMatch(NamedTuple):
    """What a window told, at its end.

    Attributes:
        C_lb: Attitude at the end of the last interval, shape (3, 3).
        v_l: Velocity of the IMU there, m/s, shape (3,).
        gyro_bias: Gyro biases, rad/s, shape (3,).
        accel_bias: Accelerometer biases, m/s², shape (3,).
        covariance: Covariance of the errors at the end: attitude φ (rad; Ĉ_lb = (I + [φ×]) C_lb)
            and velocity, east, north, up, gyro bias, accelerometer bias, shape (12, 12).
        misfit: Root mean square of the velocity residuals in their standard deviations.
    """

    C_lb: Tensor
    v_l: Tensor
    gyro_bias: Tensor
    accel_bias: Tensor
    covariance: Tensor
    misfit: float


class _Problem(NamedTuple):
    window: Window
    gyro_bias: Tensor
    prior: Tensor
    options: MatchingOptions


class _System(NamedTuple):
    """Whitened rows: the fixes' first, then course, then what was known before."""

    residual: Tensor
    by_error: Tensor
    data: int


def wahba(v_l: Tensor, v_b: Tensor, weight: Tensor) -> Tensor:
    """Return the rotation that best turns vectors of one frame into those of another.

    [Markley1988], by singular values.

    Args:
        v_l: Vectors in the target frame, shape (N, 3).
        v_b: The same vectors in the source frame, shape (N, 3).
        weight: Weight of each, shape (N,).

    Returns:
        C_lb that minimises Σ w |v_l − C_lb v_b|², shape (3, 3).
    """
    left, _, right = torch.linalg.svd(torch.einsum("n,ni,nj->ij", weight, v_l, v_b))
    sign = torch.linalg.det(left) * torch.linalg.det(right)
    last = torch.stack((torch.ones_like(sign), torch.ones_like(sign), sign))
    C_lb: Tensor = (left * last) @ right
    return C_lb


def match_velocity(
    window: Window, gyro_bias: Tensor, gyro_bias_sigma: Tensor, options: MatchingOptions
) -> VelocityMatch:
    """Return the attitude at the end of a window, with velocity and biases.

    Args:
        window: Samples and at least three GNSS velocities.
        gyro_bias: What is known of the gyro biases, rad/s, shape (3,).
        gyro_bias_sigma: Its standard deviations, rad/s, shape (3,).
        options: Assumptions.

    Returns:
        The best of the solutions that several first guesses of azimuth lead to.
    """
    accel = torch.full_like(gyro_bias, options.accel_bias_sigma)
    # φ and velocity are not known before; half a turn keeps the equations regular.
    loose = torch.full_like(gyro_bias, math.pi)
    prior = torch.cat((loose, torch.full_like(loose, 1e3), gyro_bias_sigma, accel))
    problem = _Problem(window, gyro_bias, prior, options)
    tried = [_solve(problem, guess, 3) for guess in _first_guesses(problem)]
    best = min(tried, key=lambda pair: pair[1])[0]
    guess, _ = _solve(problem, best, options.passes)
    return _at_the_end(problem, guess)


def _first_guesses(problem: _Problem) -> list[Guess]:
    """Return guesses that level by Wahba's problem and differ in azimuth."""
    window, fixes = problem.window, problem.window.fixes
    eye, zero = torch.eye(3).to(window.lat), torch.zeros_like(problem.gyro_bias)
    flat = window.predict(Guess(eye, zero, problem.gyro_bias, zero, None))
    inertial = fixes.v_l - (flat.v_l - flat.force)[:-1]
    weight = 1.0 / (fixes.sigma[1:] ** 2 + fixes.sigma[:-1] ** 2).mean(-1)
    C_0 = wahba(torch.diff(inertial, dim=0), torch.diff(flat.force[:-1], dim=0), weight)
    azimuth, pitch, roll = angles_from_matrix(C_0)
    turned, _, _ = angles_from_matrix(C_0 @ flat.C_lb[:-1])
    told = _tells_course(fixes, problem.options)
    offsets = [0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi]
    if bool(told.any()):
        course = torch.atan2(fixes.v_l[told, 0], fixes.v_l[told, 1]) - turned[told]
        middle = float(torch.atan2(torch.sin(course).sum(), torch.cos(course).sum()))
        offsets = [middle, middle + math.pi]
    attitudes = [matrix_from_angles(azimuth + offset, pitch, roll) for offset in offsets]
    return [Guess(C, fixes.v_l[0], problem.gyro_bias, zero, None) for C in attitudes]


def _solve(problem: _Problem, guess: Guess, passes: int) -> tuple[Guess, float]:
    """Return the least-squares solution and its robust cost."""
    for k in range(passes):
        predicted = problem.window.predict(guess)
        system = _system(problem, guess, predicted)
        weight = _weight(system, robust=k > 0)
        rows = system.by_error * weight.unsqueeze(-1)
        normal, right = rows.T @ system.by_error, rows.T @ system.residual
        error = torch.linalg.solve(normal, right)
        turn = torch.linalg.vector_norm(error[:3])
        # Far from the solution a linear step of more than half a radian points nowhere.
        error = torch.where(turn > 0.5, error * (0.5 / turn.clamp(min=1e-12)), error)
        guess = corrected(guess, error, predicted.middle)
        if float((error / problem.prior).abs().max()) < 1e-5:
            break
    system = _system(problem, guess, problem.window.predict(guess))
    return guess, float(system.residual.abs().clamp(max=3.0).square().sum())


def _system(problem: _Problem, guess: Guess, predicted: Prediction) -> _System:
    fixes, options = problem.window.fixes, problem.options
    misfit = fixes.v_l - (predicted.v_l + predicted.arm_l)[:-1]
    residual = [(misfit / fixes.sigma).flatten()]
    rows = [(predicted.by_error[:-1] / fixes.sigma.unsqueeze(-1)).flatten(0, 1)]
    told = torch.nonzero(_tells_course(fixes, options))[:, 0]
    if len(told):
        right = predicted.C_lb[told, :, 0]
        v_l = fixes.v_l[told] - predicted.arm_l[told]
        sigma = _slip(problem, told)
        residual.append(-(right * v_l).sum(-1) / sigma)
        lever = torch.linalg.cross(v_l, right).unsqueeze(-2)
        rows.append((lever @ predicted.turned[told]).squeeze(-2) / sigma.unsqueeze(-1))
    zero = torch.zeros_like(problem.gyro_bias)
    known = (zero, zero, guess.gyro_bias - problem.gyro_bias, guess.accel_bias)
    residual.append(torch.cat(known) / problem.prior)
    rows.append(torch.diag(1.0 / problem.prior))
    data = 3 * len(misfit)
    return _System(torch.cat(residual), torch.cat(rows), data)


def _tells_course(fixes: VelocityFixes, options: MatchingOptions) -> Tensor:
    fast = torch.hypot(fixes.v_l[:, 0], fixes.v_l[:, 1]) > options.course_speed
    return fast & math.isfinite(options.slip_sigma)


def _slip(problem: _Problem, told: Tensor) -> Tensor:
    """Return how far sideways the car may move at fixes, m/s; slip is the same for all of them."""
    fixes, options = problem.window.fixes, problem.options
    speed = torch.hypot(fixes.v_l[told, 0], fixes.v_l[told, 1])
    turn = problem.window.samples.omega_ib_b[fixes.end[told].clamp(min=0), 2].abs()
    slip = math.sqrt(len(told)) * options.slip_sigma * speed
    return slip + options.axle_distance * turn + fixes.sigma[told, :2].amax(-1)


def _weight(system: _System, *, robust: bool) -> Tensor:
    """Return Huber's weights of the fixes' rows; what was known before keeps its own."""
    weight = torch.ones_like(system.residual)
    if robust:
        size = system.residual[: system.data].abs()
        scale = (1.4826 * size.median()).clamp(min=1.0)
        weight[: system.data] = (2.0 * scale / size.clamp(min=1e-12)).clamp(max=1.0)
    return weight


def _at_the_end(problem: _Problem, guess: Guess) -> VelocityMatch:
    predicted = problem.window.predict(guess)
    system = _system(problem, guess, predicted)
    weight = _weight(system, robust=True)
    spread = (weight * system.residual**2)[: system.data].sum() / max(system.data - 12, 1)
    weight[: system.data] /= spread.clamp(min=1.0)
    start = torch.linalg.inv((system.by_error * weight.unsqueeze(-1)).T @ system.by_error)
    walk = problem.options.attitude_walk**2 * problem.window.samples.dt.sum()
    carried, walked = torch.eye(12).to(start), torch.zeros(12).to(start)
    walked[:3] = walk
    # What was added is the true velocity's derivative; the error's has the other sign.
    carried[:3], carried[3:6] = predicted.turned[-1], -predicted.by_error[-1]
    return VelocityMatch(
        predicted.C_lb[-1],
        predicted.v_l[-1],
        guess.gyro_bias,
        guess.accel_bias,
        carried @ start @ carried.T + torch.diag(walked),
        float(system.residual[: system.data].square().mean().sqrt()),
    )
