"""Dead reckoning of a full IMU without a filter: the plainest baseline.

Position and velocity of the last fix, attitude by velocity matching over the stretch before it,
gyro biases from standstill as far as there was one; then the strapdown runs alone.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import matrix_from_quaternion
from navlearn.errors import LogError
from navlearn.mechanization.confirmed_standstill import confirmed_standstill
from navlearn.mechanization.ins_alignment_result import (
    InsAlignment,
    InsAlignmentOptions,
    state_at_fix,
)
from navlearn.mechanization.matched_alignment import matched_at
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState


@dataclass(frozen=True, kw_only=True)
class InsDeadReckoningOptions:
    """What full-IMU dead reckoning takes from the time before the outage.

    Attributes:
        windows: Lengths of the stretches that attitude is matched over, s: the next is tried
            where one does not tell azimuth, as at a traffic light.
        alignment: What matching assumes, and how well azimuth must be known.
    """

    windows: tuple[float, ...] = (60.0, 120.0, 240.0, 480.0)
    alignment: InsAlignmentOptions = field(default_factory=InsAlignmentOptions)


class InsDeadReckoningStart(NamedTuple):
    """Where full-IMU dead reckoning starts.

    Attributes:
        sample: It starts at the end of this interval.
        state: Position and velocity of the last fix, attitude matched before it.
        gyro_bias: Gyro biases, rad/s, shape (3,).
        accel_bias: Accelerometer biases, m/s², shape (3,).
    """

    sample: int
    state: InsState
    gyro_bias: Tensor
    accel_bias: Tensor


def ins_dead_reckoning_start(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    options: InsDeadReckoningOptions | None = None,
    *,
    bridged: Tensor | None = None,
) -> InsDeadReckoningStart:
    """Return the state from which a strapdown alone runs through an outage.

    Args:
        samples: Intervals up to the last fix and beyond, shape (T,) and (T, 3) each; nothing
            beyond it is looked at.
        fixes: Fixes before the outage, shape (M,) each.
        timing: Where the fixes fall, shape (M,) each.
        options: Windows and thresholds; None means the defaults.
        bridged: Where a gap in the IMU was bridged, bool, shape (T,): no stretch reaches across
            one if what follows it tells an attitude at all; None means nowhere.

    Returns:
        Start at the interval of the last fix that has position and velocity.

    Raises:
        LogError: If no fix has both, or no stretch before it tells the attitude.
    """
    options = options or InsDeadReckoningOptions()
    usable = (timing.index >= 0) & (fixes.has_position > 0) & (fixes.has_velocity > 0)
    found = torch.nonzero(usable)[:, 0]
    if len(found) == 0:
        raise LogError(
            "full-IMU dead reckoning: no fix before the outage has both position and velocity; "
            "start the outage later, or use a log whose receiver tells velocity"
        )
    m = int(found[-1])
    samples = confirmed_standstill(samples, fixes, timing)
    matched = _matched(samples, fixes, timing, m, options, bridged)
    if matched is None and bridged is not None:
        matched = _matched(samples, fixes, timing, m, options, None)
    if matched is None:
        raise LogError(
            f"full-IMU dead reckoning: no stretch of up to {max(options.windows):g} s before the "
            "last fix in which the car moved and its receiver told velocities; start the outage "
            "later"
        )
    C_lb, arm = matrix_from_quaternion(matched.state.q_lb), options.alignment.lever_arm
    turn = samples.omega_ib_b[matched.sample] - matched.gyro_bias
    antenna = torch.stack((fixes.v_e[m], fixes.v_n[m], fixes.v_u[m]))
    v_l = antenna - C_lb @ torch.linalg.cross(turn, turn.new_tensor(arm))
    if bool(samples.stationary[matched.sample] > 0.5):
        v_l = torch.zeros_like(v_l)
    state = state_at_fix(C_lb, v_l, fixes, timing, m, arm)
    return InsDeadReckoningStart(matched.sample, state, matched.gyro_bias, matched.accel_bias)


def _matched(
    samples: ImuSample,
    fixes: GnssFix,
    timing: FixTiming,
    m: int,
    options: InsDeadReckoningOptions,
    bridged: Tensor | None,
) -> InsAlignment | None:
    """Return the best alignment that the options' windows give, or None."""
    best: InsAlignment | None = None
    for window in options.windows:
        found = matched_at(samples, fixes, timing, m, options.alignment, window, bridged=bridged)
        if found is None:
            continue
        if best is None or found.attitude_sigma[2] < best.attitude_sigma[2]:
            best = found
        if float(best.attitude_sigma[2]) <= options.alignment.azimuth_sigma:
            return best
    return best
