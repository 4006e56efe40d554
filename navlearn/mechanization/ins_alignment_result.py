"""What alignment of a full IMU is asked and what it answers."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import angles_from_matrix, quaternion_from_angles
from navlearn.errors import ConfigError
from navlearn.mechanization.velocity_matching import MatchingOptions
from navlearn.states import FixTiming, GnssFix, InsState

Method = Literal["levelled+course", "velocity_matching", "stated"]


@dataclass(frozen=True, kw_only=True)
class InsAlignmentOptions:
    """How a full-IMU filter is started.

    Attributes:
        method: ``levelled+course`` or ``velocity_matching``; ``auto`` takes what works first, and
            levelling where the car has just stood.
        standstill: Shortest standstill that is levelled on and tells gyro biases, s.
        carry: Longest time over which gyros carry a levelled attitude to the first fast fix, s.
        speed: Slowest GNSS speed (and odometer speed, where there is one) at which course is
            taken for azimuth, m/s.
        window: Longest window of velocity matching, s.
        least_window: Shortest, s.
        least_fixes: Fewest GNSS velocities in it.
        azimuth_sigma: Velocity matching goes on until azimuth is this well known, rad.
        tilt_sigma: The same of pitch and roll, rad.
        gyro_bias_sigma: Standard deviation of gyro biases of a car that never stood, rad/s.
        gyro_bias_sigma_at_rest: Standard deviation of those found at rest, rad/s.
        velocity_sigma: Smallest standard deviation of GNSS velocity believed, m/s.
        lever_arm: GNSS antenna from the IMU, body RFU, m.
        matching: What velocity matching assumes of course and accelerometers.
    """

    method: Literal["auto", "levelled+course", "velocity_matching"] = "auto"
    standstill: float = 10.0
    carry: float = 60.0
    speed: float = 4.0
    window: float = 60.0
    least_window: float = 10.0
    least_fixes: int = 6
    azimuth_sigma: float = math.radians(3.0)
    tilt_sigma: float = math.radians(1.5)
    gyro_bias_sigma: float = math.radians(0.5)
    gyro_bias_sigma_at_rest: float = math.radians(0.02)
    velocity_sigma: float = 0.05
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    matching: MatchingOptions = field(default_factory=MatchingOptions)

    def __post_init__(self) -> None:
        """Refuse an unknown method.

        Raises:
            ConfigError: It is none of the three.
        """
        known = ("auto", "levelled+course", "velocity_matching")
        if self.method not in known:
            raise ConfigError(
                f"InsAlignmentOptions.method: found {self.method!r}; choose among "
                f"{', '.join(known)}"
            )

    def with_lever_arm(self, lever_arm: tuple[float, float, float]) -> "InsAlignmentOptions":
        """Return the options for another antenna."""
        return replace(self, lever_arm=lever_arm)


class InsAlignment(NamedTuple):
    """Where and with what a full-IMU filter starts.

    Attributes:
        sample: It starts at the end of this interval; −1 before the first.
        state: Position of the fix, velocity and attitude of the IMU, scalars and vectors.
        attitude_sigma: Standard deviation of the attitude error about east, north and up, rad,
            shape (3,).
        position_sigma: Horizontal standard deviation, m.
        height_sigma: Standard deviation of the height, m.
        velocity_sigma: Standard deviation of velocity east, north and up, m/s, shape (3,).
        gyro_bias: Gyro biases, rad/s, shape (3,); zero where nothing told them.
        gyro_bias_sigma: Their standard deviations, rad/s, shape (3,).
        accel_bias: Accelerometer biases, m/s², shape (3,).
        accel_bias_sigma: Their standard deviations, m/s², shape (3,).
        method: How it was found.
    """

    sample: int
    state: InsState
    attitude_sigma: Tensor
    position_sigma: float
    height_sigma: float
    velocity_sigma: Tensor
    gyro_bias: Tensor
    gyro_bias_sigma: Tensor
    accel_bias: Tensor
    accel_bias_sigma: Tensor
    method: Method


def stated_alignment(
    state: InsState, *, tilt: float, azimuth: float, position: float, velocity: float
) -> InsAlignment:
    """Return the alignment of a drive whose state before its first interval is known.

    Args:
        state: The state, no batch axes.
        tilt: Standard deviation of pitch and roll, rad.
        azimuth: Standard deviation of azimuth, rad.
        position: Standard deviation of position east, north and up, m.
        velocity: Standard deviation of each velocity component, m/s.

    Returns:
        Alignment before the first interval (``sample`` −1), biases zero and as uncertain as those
        of a car that never stood.
    """
    like, assumed = state.v_l, InsAlignmentOptions()
    return InsAlignment(
        sample=-1,
        state=state,
        attitude_sigma=like.new_tensor([tilt, tilt, azimuth]),
        position_sigma=position,
        height_sigma=position,
        velocity_sigma=torch.full_like(like, velocity),
        gyro_bias=torch.zeros_like(like),
        gyro_bias_sigma=torch.full_like(like, assumed.gyro_bias_sigma),
        accel_bias=torch.zeros_like(like),
        accel_bias_sigma=torch.full_like(like, assumed.matching.accel_bias_sigma),
        method="stated",
    )


def state_at_fix(
    C_lb: Tensor,
    v_l: Tensor,
    fixes: GnssFix,
    timing: FixTiming,
    m: int,
    lever_arm: tuple[float, float, float],
) -> InsState:
    """Return the state of the IMU at the end of the interval at which a fix is used.

    Args:
        C_lb: Attitude there, shape (3, 3).
        v_l: Velocity of the IMU there, m/s, shape (3,).
        fixes: Fixes, shape (M,) each.
        timing: Where they fall, shape (M,) each.
        m: The fix.
        lever_arm: GNSS antenna from the IMU, body RFU, m.
    """
    east, north, up = v_l * timing.delay[m] - C_lb @ v_l.new_tensor(lever_arm)
    lat, height = fixes.lat[m], fixes.height[m]
    radius = (earth.prime_vertical_radius(lat) + height) * torch.cos(lat)
    return InsState(
        lat + north / (earth.meridian_radius(lat) + height),
        fixes.lon[m] + east / radius,
        height + up,
        v_l,
        quaternion_from_angles(*angles_from_matrix(C_lb)),
    )
