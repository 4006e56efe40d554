"""The window of velocity matching as a least-squares problem: prediction and derivatives.

Errors are those at the window's start, estimate minus truth: attitude φ, velocity, gyro bias,
accelerometer bias, three each. With D = ∫ C_lb dt and S = ∫ C_lb f dt, a gyro bias error turns the
attitude by −D δb, and velocity changes by [S×] φ − δv − (∫ [C_lb f ×] D dt) δb_g + D δb_a.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_quaternion, quaternion_from_rotation_vector
from navlearn.mechanization.preintegration_sums import skew
from navlearn.mechanization.turning import level_rate, turned_since_start
from navlearn.states import ImuSample


class VelocityFixes(NamedTuple):
    """GNSS velocities within a window, shape (M,) each unless said otherwise.

    Attributes:
        end: Each is used at the end of this interval of the window, int64; −1 at its begin.
        delay: That moment minus the time at which the fix was valid, s.
        v_l: Velocity of the antenna east, north, up, m/s, shape (M, 3).
        sigma: Standard deviations east, north, up, m/s, shape (M, 3).
    """

    end: Tensor
    delay: Tensor
    v_l: Tensor
    sigma: Tensor


class Guess(NamedTuple):
    """State at a window's start, and the attitude that the last guess led to.

    Attributes:
        C_0: Attitude at the start, C_lb, shape (3, 3).
        v_0: Velocity there, m/s, shape (3,).
        gyro_bias: Gyro biases, rad/s, shape (3,).
        accel_bias: Accelerometer biases, m/s², shape (3,).
        C_lb: Attitude in the middle of every interval, shape (T, 3, 3), or None at first: it
            turns the rate of the local level into the body.
    """

    C_0: Tensor
    v_0: Tensor
    gyro_bias: Tensor
    accel_bias: Tensor
    C_lb: Tensor | None


class Prediction(NamedTuple):
    """What a guess predicts at M fixes; the last row of derivatives belongs to the window's end.

    Attributes:
        v_l: Velocity of the IMU, m/s, shape (M + 1, 3).
        by_error: Derivative of the true velocity in the start's errors, shape (M + 1, 3, 12).
        turned: Derivative of the attitude error in them, shape (M + 1, 3, 12).
        C_lb: Attitude, shape (M + 1, 3, 3).
        arm_l: Velocity of the antenna against the IMU, m/s, shape (M + 1, 3).
        middle: Attitude in the middle of every interval, shape (T, 3, 3).
        force: Velocity that specific force has added, m/s, shape (M + 1, 3).
    """

    v_l: Tensor
    by_error: Tensor
    turned: Tensor
    C_lb: Tensor
    arm_l: Tensor
    middle: Tensor
    force: Tensor


@dataclass(frozen=True, kw_only=True)
class Window:
    """Samples and fixes of one window.

    Attributes:
        samples: Intervals, shape (T,) and (T, 3) each.
        fixes: GNSS velocities.
        lat: Latitude, rad, scalar.
        height: Height, m, scalar.
        lever_arm: GNSS antenna from the IMU, body RFU, m, shape (3,).
    """

    samples: ImuSample
    fixes: VelocityFixes
    lat: Tensor
    height: Tensor
    lever_arm: Tensor

    def gravity_and_coriolis(self) -> Tensor:
        """Return what accelerates a body besides specific force, m/s², shape (T, 3)."""
        v_l = _interpolated(self.fixes, self.samples.dt)
        frame = level_rate(self.lat, self.height, v_l) + earth.earth_rate_enu(self.lat)
        held: Tensor = -torch.linalg.cross(frame, v_l)
        gravity = earth.normal_gravity(self.lat, self.height)
        return torch.stack((held[:, 0], held[:, 1], held[:, 2] - gravity), -1)

    def predict(self, guess: Guess) -> Prediction:
        """Return what a guess predicts, and how errors of the guess change it.

        Args:
            guess: State at the window's start.
        """
        dt = self.samples.dt
        rate = self.samples.omega_ib_b - guess.gyro_bias
        against = rate
        if guess.C_lb is not None:
            level = level_rate(self.lat, self.height, _interpolated(self.fixes, dt))
            against = rate - (guess.C_lb.transpose(-1, -2) @ level.unsqueeze(-1)).squeeze(-1)
        middle, end = turned_since_start(against, dt)
        middle, end = guess.C_0 @ middle, guess.C_0 @ end
        force = (self.samples.f_b - guess.accel_bias).unsqueeze(-2) @ middle.transpose(-1, -2)
        added = force.squeeze(-2) * dt.unsqueeze(-1)
        way = middle * dt[:, None, None]
        D = torch.cumsum(way, 0)
        G = torch.cumsum(skew(added) @ (D - 0.5 * way), 0)
        other = torch.cumsum(self.gravity_and_coriolis() * dt.unsqueeze(-1), 0)
        S = torch.cumsum(added, 0)
        at = self._at_fixes
        C_lb = torch.cat((guess.C_0.unsqueeze(0), end))[self._ends + 1]
        turn = rate[self._ends.clamp(min=0)]
        arm = torch.linalg.cross(turn, self.lever_arm.expand_as(turn)).unsqueeze(-1)
        S_at, D_at, eye = at(S), at(D), torch.eye(3).to(dt).expand(len(self._ends), 3, 3)
        zero = torch.zeros_like(eye)
        return Prediction(
            guess.v_0 + S_at + at(other),
            torch.cat((skew(S_at), -eye, -at(G), D_at), -1),
            torch.cat((eye, zero, -D_at, zero), -1),
            C_lb,
            (C_lb @ arm).squeeze(-1),
            middle,
            S_at,
        )

    @property
    def _ends(self) -> Tensor:
        last = self.fixes.end.new_tensor([len(self.samples.dt) - 1])
        return torch.cat((self.fixes.end, last))

    def _at_fixes(self, running: Tensor) -> Tensor:
        """Return a running integral when the fixes were valid, and at the end."""
        padded = torch.cat((torch.zeros_like(running[:1]), running))
        ends = self._ends
        dt = self.samples.dt[ends.clamp(min=0)]
        back = torch.cat((self.fixes.delay, torch.zeros_like(dt[:1]))) / dt
        back = back.view(-1, *[1] * (running.dim() - 1))
        slope = running[ends.clamp(min=0)] - padded[ends.clamp(min=0)]
        return padded[ends + 1] - back * slope


def corrected(guess: Guess, error: Tensor, middle: Tensor) -> Guess:
    """Return a guess less its estimated errors.

    Args:
        guess: State at the window's start.
        error: Estimate of its errors, shape (12,).
        middle: Attitude that the guess led to, shape (T, 3, 3).
    """
    phi, v, gyro, accel = error.view(4, 3).unbind(0)
    turn = matrix_from_quaternion(quaternion_from_rotation_vector(-phi))
    return Guess(
        turn @ guess.C_0,
        guess.v_0 - v,
        guess.gyro_bias - gyro,
        guess.accel_bias - accel,
        turn @ middle,
    )


def _interpolated(fixes: VelocityFixes, dt: Tensor) -> Tensor:
    """Return the velocity that the fixes tell in the middle of every interval, shape (T, 3)."""
    clock = torch.cumsum(dt, 0)
    known = torch.where(fixes.end >= 0, clock[fixes.end.clamp(min=0)], 0.0) - fixes.delay
    middle = clock - 0.5 * dt
    right = torch.searchsorted(known.contiguous(), middle).clamp(1, len(known) - 1)
    share = (middle - known[right - 1]) / (known[right] - known[right - 1]).clamp(min=1e-6)
    share = share.clamp(0.0, 1.0).unsqueeze(-1)
    return fixes.v_l[right - 1] * (1.0 - share) + fixes.v_l[right] * share
