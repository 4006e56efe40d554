"""How noisy a RISS filter takes its sensors and fixes to be, and how sure it starts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """Noise densities and standard deviations; every one may be learned through the filter.

    The defaults suit a consumer MEMS gyro (bias instability 60 °/h after an hour) and were chosen
    on simulated drives of the grades ``mems_x``, ``mems_l`` and ``mems_m``; a better gyro wants
    smaller figures, a coarse odometer a larger ``speed_noise``.

    Attributes:
        gyro_random_walk: Angle random walk of the gyro, rad/√s.
        turn_noise: What turning adds, √s: uncertainty of the gyro's scale factor times the root
            of the length of a turn; the density grows by (turn_noise · turn rate)².
        gyro_bias_walk: Random walk of the gyro bias, rad/s/√s.
        speed_scale_walk: Random walk of the odometer scale, 1/√s.
        pitch_bias_walk: Random walk of the pitch bias, rad/√s.
        position_walk: What moves the car sideways of the model, per horizontal axis, m/√s.
        height_walk: The same upwards, m/√s, where the mechanization climbs (3D).
        hill_walk: The same in 2D, where every hill comes as a surprise, m/√s.
        velocity_walk: Of the velocity states of the Shen models, m/s/√s.
        acceleration_walk: Driving noise of the odometer acceleration bias of the Shen models,
            m/s²/√s.
        position_floor: Added in quadrature to the receiver's horizontal deviations, m.
        height_floor: Added in quadrature to the receiver's vertical deviation, m.
        position_inflation: Factor on the receiver's deviations of position and height.
        velocity_floor: Added in quadrature to the receiver's velocity deviation, m/s.
        velocity_inflation: Factor on the receiver's velocity deviation.
        speed_noise: Noise of one odometer sample, as a velocity fix meets it, m/s.
        zero_yaw_rate: Deviation of the mean yaw rate over one second of standstill, rad/s; over
            less than a second it is larger by the root of the time, over more it stays.
        zero_speed: Deviation of a zero-velocity measurement (Shen models), m/s.
    """

    gyro_random_walk: float = math.radians(0.6) / 60.0
    turn_noise: float = 0.03
    gyro_bias_walk: float = math.radians(60.0) / 3600.0 / 60.0
    speed_scale_walk: float = 1e-4
    pitch_bias_walk: float = math.radians(0.01)
    position_walk: float = 0.2
    height_walk: float = 0.1
    hill_walk: float = 3.0
    velocity_walk: float = 0.03
    acceleration_walk: float = 0.01
    position_floor: float = 0.3
    height_floor: float = 0.5
    position_inflation: float = 1.5
    velocity_floor: float = 0.03
    velocity_inflation: float = 1.0
    speed_noise: float = 0.1
    zero_yaw_rate: float = math.radians(0.02)
    zero_speed: float = 0.05


@dataclass(frozen=True, kw_only=True)
class InitialOptions:
    """Standard deviations at the start, where the caller has none of its own.

    Attributes:
        position: East and north, m.
        height: Up, m.
        velocity: Velocity states of the Shen models, m/s.
        azimuth: Azimuth, rad.
        acceleration_bias: Odometer acceleration bias of the Shen models, m/s².
        gyro: Per gyro term: ``bias`` rad/s, ``scale`` and ``abs_scale`` per rad/s,
            ``quadratic`` per (rad/s)², ``f_x`` and ``f_y`` rad/s per m/s².
        speed: Per speed term: ``scale`` as a fraction, ``delay`` in s, ``offset`` in m/s.
        pitch_bias: Pitch bias, rad.
    """

    position: float = 3.0
    height: float = 5.0
    velocity: float = 0.5
    azimuth: float = math.radians(5.0)
    acceleration_bias: float = 0.05
    gyro: Mapping[str, float] = field(
        default_factory=lambda: {
            "bias": math.radians(0.1),
            "scale": 0.03,
            "abs_scale": 0.009,
            "quadratic": 0.015,
            "f_x": math.radians(0.3) / 9.81,
            "f_y": math.radians(0.3) / 9.81,
        }
    )
    speed: Mapping[str, float] = field(
        default_factory=lambda: {"scale": 0.03, "delay": 0.2, "offset": 0.1}
    )
    pitch_bias: float = math.radians(1.0)
