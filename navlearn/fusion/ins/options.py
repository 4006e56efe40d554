"""What a user may choose about the loosely coupled full-IMU filter."""

import math
from dataclasses import dataclass, field, fields
from typing import Literal

from navlearn.errors import ConfigError
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.gate_options import GateOptions


@dataclass(frozen=True, kw_only=True)
class InsNoiseOptions:
    """Noise densities and standard deviations; every one may be learned through the filter.

    The defaults suit an automotive MEMS IMU and were chosen on simulated drives of the grade
    ``mems_m``; the random walks stand above those of its data sheet because they also answer for
    what is no state (nonlinearity, cross-axis and, with 15 states, scale factors).

    Attributes:
        gyro_random_walk: Angle random walk of the gyros, rad/√s.
        accel_random_walk: Velocity random walk of the accelerometers, m/s/√s.
        turn_noise: What turning adds to all gyros, √s: uncertainty of their scale factors times
            the root of the length of a turn; the density grows by (turn_noise · turn rate)².
        gyro_bias_walk: Random walk of the gyro biases, rad/s/√s.
        accel_bias_walk: Random walk of the accelerometer biases, m/s²/√s.
        gyro_scale_walk: Random walk of the gyro scale factors, 1/√s.
        accel_scale_walk: Random walk of the accelerometer scale factors, 1/√s.
        odometer_scale_walk: Random walk of the odometer scale, 1/√s.
        position_floor: Added in quadrature to the receiver's horizontal deviations, m.
        height_floor: Added in quadrature to the receiver's vertical deviation, m.
        position_inflation: Factor on the receiver's deviations of position and height.
        velocity_floor: Added in quadrature to the receiver's velocity deviation, m/s.
        velocity_inflation: Factor on the receiver's velocity deviation.
        odometer_noise: Deviation of the odometer speed at a block's end, m/s.
        nonholonomic_noise: Deviation of the car's sideways and upward velocity at the rear axle,
            m/s.
        zero_velocity: Deviation of the velocity of a car that stands, m/s.
        zero_angular_rate: Deviation of the mean gyros over one second of standstill, rad/s; over
            less than a second it is larger by the root of the time, over more it stays.
    """

    gyro_random_walk: float = math.radians(0.6) / 60.0
    accel_random_walk: float = 0.01
    turn_noise: float = 0.01
    gyro_bias_walk: float = math.radians(60.0) / 3600.0 / 60.0
    accel_bias_walk: float = 3e-4
    gyro_scale_walk: float = 1e-5
    accel_scale_walk: float = 1e-5
    odometer_scale_walk: float = 1e-4
    position_floor: float = 0.3
    height_floor: float = 0.5
    position_inflation: float = 1.5
    velocity_floor: float = 0.03
    velocity_inflation: float = 1.0
    odometer_noise: float = 0.1
    nonholonomic_noise: float = 0.1
    zero_velocity: float = 0.02
    zero_angular_rate: float = math.radians(0.02)


@dataclass(frozen=True, kw_only=True)
class InsInitialOptions:
    """Standard deviations at the start, where the caller has none of its own.

    Attributes:
        position: East and north, m.
        height: Up, m.
        velocity: Each component, m/s.
        tilt: About east and north, rad.
        azimuth: About up, rad.
        gyro_bias: Each axis, rad/s.
        accel_bias: Each axis, m/s².
        gyro_scale: Each axis, a fraction.
        accel_scale: Each axis, a fraction.
        odometer_scale: A fraction.
    """

    position: float = 3.0
    height: float = 5.0
    velocity: float = 0.5
    tilt: float = math.radians(1.0)
    azimuth: float = math.radians(5.0)
    gyro_bias: float = math.radians(0.2)
    accel_bias: float = 0.08
    gyro_scale: float = 0.005
    accel_scale: float = 0.003
    odometer_scale: float = 0.03


@dataclass(frozen=True, kw_only=True)
class InsEkfOptions:
    """Choices of the loosely coupled full-IMU filter.

    Attributes:
        states: 9 (position, velocity, attitude), 15 (and biases) or 21 (and scale factors). With 9
            nothing holds a bias: take what alignment found of it off the samples first.
        model: ``phi_angle``, the complete linear error model, or ``dahmane2022``, the simplified
            one of [Dahmane2022] with its slips repaired (which that paper runs with 9 states).
        feedback: ``closed`` feeds errors back after each update; ``open`` lets the mechanization
            run free and estimates its error beside it.
        odometer_scale: Whether the odometer's scale error is a state.
        position: Whether GNSS positions are used.
        velocity: Whether GNSS velocities are used.
        vertical_velocity: Whether these tell how the car climbs, too; a receiver without vertical
            velocity must not be read as one that says zero.
        odometer: Whether the odometer's speed is used where there is one.
        nonholonomic: Whether the rear axle is taken to move neither sideways nor up.
        zero_velocity: Whether standstill holds the velocity at zero.
        zero_angular_rate: Whether standstill observes the gyros' errors.
        correlation_time: Of the biases, as Gauss–Markov processes about zero, s; infinite makes
            them random walks.
        lever_arm: GNSS antenna from the IMU, body RFU, m.
        wheel_lever_arm: Middle of the rear axle from the IMU, body RFU, m.
        mounting: Azimuth, pitch and roll of the IMU's axes against the car's, rad: by how much
            the IMU looks further right, is tipped nose up, and right side down.
        least_speed: Slowest speed at which the odometer and the axle are listened to, m/s.
        aiding_interval: Shortest time between two uses of odometer and axle, s; they come at the
            ends of blocks, through an outage too.
        standstill: Shortest standstill up to a block's end that counts, s.
        max_block: Longest time between updates, s.
        noise: Noise densities and deviations.
        initial: Standard deviations at the start.
        gate: When a measurement is refused.
        unscented: Sigma points of the unscented filter; None is the extended one.
    """

    states: Literal[9, 15, 21] = 15
    model: Literal["phi_angle", "dahmane2022"] = "phi_angle"
    feedback: Literal["closed", "open"] = "closed"
    odometer_scale: bool = True
    position: bool = True
    velocity: bool = True
    vertical_velocity: bool = True
    odometer: bool = True
    nonholonomic: bool = True
    zero_velocity: bool = True
    zero_angular_rate: bool = True
    correlation_time: float = math.inf
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wheel_lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    least_speed: float = 0.0
    aiding_interval: float = 1.0
    standstill: float = 0.5
    max_block: float = 1.0
    noise: InsNoiseOptions = field(default_factory=InsNoiseOptions)
    initial: InsInitialOptions = field(default_factory=InsInitialOptions)
    gate: GateOptions = field(default_factory=GateOptions)
    unscented: UnscentedOptions | None = None

    def __post_init__(self) -> None:
        """Refuse what no filter can do.

        Raises:
            ConfigError: If an option is unknown or outside its range.
        """
        for name, found, known in (
            ("states", self.states, (9, 15, 21)),
            ("model", self.model, ("phi_angle", "dahmane2022")),
            ("feedback", self.feedback, ("closed", "open")),
        ):
            if found not in known:
                choices = ", ".join(map(str, known))
                raise ConfigError(f"InsEkfOptions.{name}: found {found!r}; choose among {choices}")
        self._check_ranges()
        gate = self.gate
        if gate.tests_motion and gate.motion_reference == "odometer" and not self.odometer:
            raise ConfigError(
                "InsEkfOptions: found gate.motion_limit against the odometer, and odometer false; "
                "leave motion_limit out, choose motion_reference none, or use the odometer"
            )
        for arm in ("lever_arm", "wheel_lever_arm", "mounting"):
            value = getattr(self, arm)
            if len(value) != 3 or not all(math.isfinite(x) for x in value):
                raise ConfigError(
                    f"InsEkfOptions.{arm}: found {value}; expected three finite numbers"
                )
        if max(map(abs, self.mounting)) > math.pi:
            raise ConfigError(
                f"InsEkfOptions.mounting: found {self.mounting}; expected radians within ±π: "
                "convert degrees with math.radians"
            )

    def _check_ranges(self) -> None:
        for name in ("correlation_time", "max_block"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"InsEkfOptions.{name}: found {getattr(self, name)}; expected more than 0 s"
                )
        if self.max_block > 1.0:
            raise ConfigError(
                f"InsEkfOptions.max_block: found {self.max_block}; expected at most 1 s, beyond "
                "which a block's linearisation is poor"
            )
        for name in ("least_speed", "aiding_interval", "standstill"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(
                    f"InsEkfOptions.{name}: found {getattr(self, name)}; expected a finite value "
                    ">= 0"
                )
        for group, positive in ((self.noise, False), (self.initial, True)):
            for entry in fields(group):
                value = getattr(group, entry.name)
                if not 0.0 <= value < math.inf or (positive and value == 0.0):
                    sign = ">" if positive else ">="
                    raise ConfigError(
                        f"{type(group).__name__}.{entry.name}: found {value}; expected a finite "
                        f"value {sign} 0"
                    )

    @property
    def has_odometer_scale(self) -> bool:
        """Whether the odometer's scale error is a state: where the odometer is used, too."""
        return self.odometer and self.odometer_scale
