"""Levelled at rest, azimuth from course: the alignment of a car that parks before it drives.

Pitch, roll and gyro biases come from the last standstill; the gyros carry the attitude to the
first fast fix, whose course is the azimuth ([Groves2013] §5.6). Earth rate takes part once azimuth
is known to a first approximation.
"""

import math

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import angles_from_matrix, matrix_from_angles
from navlearn.mechanization.ins_alignment_result import (
    InsAlignment,
    InsAlignmentOptions,
    state_at_fix,
)
from navlearn.mechanization.levelling import Rest, gyro_bias_at_rest, last_rest, tilt_at_rest
from navlearn.mechanization.turning import turned_since_start
from navlearn.states import FixTiming, GnssFix, ImuSample

VERTICAL_BIAS_SIGMA = 0.02
"""How well a standstill tells the accelerometer bias along gravity, m/s²: what gravity itself, a
scale factor and a tilt leave."""


def rest_before(
    samples: ImuSample,
    end: int,
    options: InsAlignmentOptions,
    bridged: Tensor | None = None,
) -> Rest | None:
    """Return the standstill that an attitude at the end of an interval may be levelled on.

    Args:
        samples: Intervals, shape (T,) and (T, 3) each.
        end: The interval.
        options: How long it must be, and how long ago it may be over.
        bridged: Where a gap in the IMU was bridged, bool, shape (T,): none may lie since.
    """
    rest = last_rest(samples, end + 1, options.standstill)
    if rest is None:
        return None
    since = slice(rest.last + 1, end + 1)
    if bridged is not None and bool(bridged[since].any()):
        return None
    return rest if float(samples.dt[since].sum()) <= options.carry else None


def drives_forward(
    samples: ImuSample, fixes: GnssFix, timing: FixTiming, m: int, speed: float
) -> bool:
    """Return whether a fix, and the odometer where there is one, say that the car drives fast.

    Args:
        samples: Intervals, shape (T,) each.
        fixes: Fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        m: The fix.
        speed: Slowest speed that counts, m/s.
    """
    end = int(timing.index[m])
    told = bool(samples.has_speed[end] > 0)
    fast = float(torch.hypot(fixes.v_e[m], fixes.v_n[m])) > speed
    return fast and not (told and float(samples.speed[end]) <= speed)


def levelled_at(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    m: int,
    rest: Rest,
    options: InsAlignmentOptions,
) -> InsAlignment:
    """Return the alignment at a fast fix after a standstill.

    Args:
        samples: Intervals, shape (T,) and (T, 3) each.
        fixes: Fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        m: The fix.
        rest: The standstill.
        options: Standard deviations.
    """
    end = int(timing.index[m])
    v_l = torch.stack((fixes.v_e[m], fixes.v_n[m], fixes.v_u[m]))
    C_lb, bias = _carried(samples, v_l, fixes.lat[m], rest, end, options)
    turn = samples.omega_ib_b[end] - bias
    v_imu = v_l - C_lb @ torch.linalg.cross(turn, turn.new_tensor(options.lever_arm))
    gravity = earth.normal_gravity(fixes.lat[m], fixes.height[m])
    norm = torch.linalg.vector_norm(rest.f_b)
    tilt = options.matching.accel_bias_sigma / float(gravity)
    carried = float(samples.dt[rest.last + 1 : end + 1].sum())
    tilt = math.hypot(tilt, options.gyro_bias_sigma_at_rest * carried)
    sigma_v = max(float(fixes.std_v[m]), options.velocity_sigma)
    sideways = math.hypot(2.0 * sigma_v, options.matching.axle_distance * float(turn[2]))
    azimuth = math.hypot(sideways / float(torch.hypot(v_l[0], v_l[1])), options.matching.slip_sigma)
    accel = options.matching.accel_bias_sigma
    return InsAlignment(
        sample=end,
        state=state_at_fix(C_lb, v_imu, fixes, timing, m, options.lever_arm),
        attitude_sigma=v_l.new_tensor([tilt, tilt, azimuth]),
        position_sigma=float(torch.maximum(fixes.std_e[m], fixes.std_n[m])),
        height_sigma=float(fixes.std_u[m]),
        velocity_sigma=torch.full_like(v_l, sigma_v),
        gyro_bias=bias,
        gyro_bias_sigma=torch.full_like(v_l, options.gyro_bias_sigma_at_rest),
        accel_bias=(norm - gravity) * rest.f_b / norm,
        accel_bias_sigma=v_l.new_tensor([accel, accel, min(accel, VERTICAL_BIAS_SIGMA)]),
        method="levelled+course",
    )


def _carried(
    samples: ImuSample,
    v_l: Tensor,
    lat: Tensor,
    rest: Rest,
    end: int,
    options: InsAlignmentOptions,
) -> tuple[Tensor, Tensor]:
    """Return the attitude at the end of an interval, and the gyro biases."""
    since = slice(rest.last + 1, end + 1)
    rate, dt = samples.omega_ib_b[since], samples.dt[since]
    pitch, roll = tilt_at_rest(rest.f_b)
    bias = gyro_bias_at_rest(rest.omega_ib_b, rest.f_b, lat)
    C_rest = matrix_from_angles(torch.zeros_like(pitch), pitch, roll)
    middle, ends = turned_since_start(rate - bias, dt)
    arm = torch.linalg.cross(rate[-1] - bias, rate.new_tensor(options.lever_arm))
    azimuth = torch.zeros_like(pitch)
    for _ in range(3):
        C_end = C_rest @ ends[-1]
        antenna = C_end @ arm
        course = torch.atan2(v_l[0] - antenna[0], v_l[1] - antenna[1])
        azimuth = azimuth + course - angles_from_matrix(C_end)[0]
        bias = gyro_bias_at_rest(rest.omega_ib_b, rest.f_b, lat, azimuth)
        C_rest = matrix_from_angles(azimuth, pitch, roll)
        earth_rate = (C_rest @ middle).transpose(-1, -2) @ earth.earth_rate_enu(lat)
        middle, ends = turned_since_start(rate - bias - earth_rate, dt)
    C_end = C_rest @ ends[-1]
    _, pitch, roll = angles_from_matrix(C_end)
    antenna = C_end @ arm
    course = torch.atan2(v_l[0] - antenna[0], v_l[1] - antenna[1])
    return matrix_from_angles(course, pitch, roll), bias
