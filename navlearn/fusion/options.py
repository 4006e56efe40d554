"""What a user may choose about the loosely coupled filter."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal

from navlearn.errors import ConfigError
from navlearn.mechanization.options import RissOptions

GYRO_TERMS = ("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y")
SPEED_TERMS = ("scale", "delay", "offset")
MODELS = ("bias_scale", "shen2010", "shen2010_full", "bias_free")


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


@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """When a measurement is refused.

    Attributes:
        probability: Share of good measurements that pass; 1 switches the gate off.
        reset_after: After so many refusals in a row of one kind the next is taken, with a
            covariance opened to its innovation, so that a drifted filter cannot lock itself out.
        reset_azimuth: Azimuth deviation added at such a reset, rad.
    """

    probability: float = 0.999
    reset_after: int = 10
    reset_azimuth: float = math.radians(10.0)


@dataclass(frozen=True, kw_only=True)
class EkfOptions:
    """Choices of the loosely coupled filter.

    Attributes:
        model: ``bias_scale`` (the honest default), ``bias_free`` (the same without gyro states,
            what papers often compare with), ``shen2010`` as printed, ``shen2010_full`` repaired.
        feedback: ``closed`` feeds errors back after each update; ``open`` lets the mechanization
            run free and estimates its error beside it.
        gyro_terms: Gyro error terms that are states: regressors 1, ω, |ω|, ω|ω|, f_x, f_y.
            The Shen models have their own bias, ``bias_free`` has none.
        speed_terms: Odometer error terms that are states: ``scale``; ``delay``, how early its
            stamps are; ``offset``, how much it reads too low while the car moves, as one does
            that cuts its speed to whole steps.
        pitch_bias: Whether pitch bias is a state (needs a 3D mechanization); None means in 3D.
            The Shen models have none of the three.
        correlation_time: Of the gyro bias (and of both sensor states of the Shen models) about
            its value at alignment, s; infinite makes it a random walk.
        position: Whether GNSS positions are used.
        velocity: Whether GNSS velocities are used.
        vertical_velocity: Whether they tell how the car climbs, too (in 3D); a receiver without
            vertical velocity must not be read as one that says zero.
        course: Whether GNSS course is used as azimuth; not together with ``velocity``.
        zero_yaw_rate: Whether standstill observes the gyro's error terms.
        zero_speed: Whether standstill holds position and azimuth without process noise, and in
            the Shen models observes velocity.
        course_speed: Slowest speed at which course is used, m/s.
        lever_arm: GNSS antenna from the point that navigates, body RFU, m.
        standstill: Shortest standstill up to a block's end that observes the gyro, s.
        max_block: Longest time between updates, s.
        noise: Noise densities and deviations.
        initial: Standard deviations at the start.
        gate: When a measurement is refused.
        mechanization: Choices of the RISS mechanization.
    """

    model: Literal["bias_scale", "bias_free", "shen2010", "shen2010_full"] = "bias_scale"
    feedback: Literal["closed", "open"] = "closed"
    gyro_terms: tuple[str, ...] = ("bias",)
    speed_terms: tuple[str, ...] = ("scale",)
    pitch_bias: bool | None = None
    correlation_time: float = math.inf
    position: bool = True
    velocity: bool = True
    vertical_velocity: bool = True
    course: bool = False
    zero_yaw_rate: bool = True
    zero_speed: bool = True
    course_speed: float = 3.0
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    standstill: float = 0.5
    max_block: float = 1.0
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    initial: InitialOptions = field(default_factory=InitialOptions)
    gate: GateOptions = field(default_factory=GateOptions)
    mechanization: RissOptions = field(default_factory=RissOptions)

    def __post_init__(self) -> None:
        """Refuse what no filter can do.

        Raises:
            ConfigError: If an option is unknown or outside its range.
        """
        _one_of("model", self.model, MODELS)
        _one_of("feedback", self.feedback, ("closed", "open"))
        for name, found, known in (
            ("gyro_terms", self.gyro_terms, GYRO_TERMS),
            ("speed_terms", self.speed_terms, SPEED_TERMS),
        ):
            for term in found:
                _one_of(name, term, known)
            if len(set(found)) != len(found):
                raise ConfigError(f"EkfOptions.{name}: found {found}; name each term once")
        if self.course and self.velocity:
            raise ConfigError(
                "EkfOptions: found course and velocity together; both come from one GNSS "
                "velocity, which would count twice: choose one"
            )
        if self.pitch_bias and not self.mechanization.three_d:
            raise ConfigError(
                "EkfOptions: found pitch_bias with a 2D mechanization, which uses no pitch; "
                "leave pitch_bias out or choose mechanization dimensions=3"
            )
        for name in ("correlation_time", "max_block"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(
                    f"EkfOptions.{name}: found {getattr(self, name)}; expected more than 0 s"
                )
        if not 0.0 < self.gate.probability <= 1.0:
            raise ConfigError(
                f"GateOptions.probability: found {self.gate.probability}; expected in (0, 1]"
            )
        for entry in fields(self.noise):
            value = getattr(self.noise, entry.name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(
                    f"NoiseOptions.{entry.name}: found {value}; expected a finite value >= 0"
                )

    @property
    def has_velocity_states(self) -> bool:
        """Whether the model is one of the Shen models."""
        return self.model in ("shen2010", "shen2010_full")

    @property
    def gyro_states(self) -> tuple[str, ...]:
        """The gyro terms that are states of the chosen model."""
        if self.has_velocity_states:
            return ("bias",)
        return () if self.model == "bias_free" else self.gyro_terms

    @property
    def speed_states(self) -> tuple[str, ...]:
        """The odometer terms that are states of the chosen model."""
        return () if self.has_velocity_states else self.speed_terms

    @property
    def has_pitch_state(self) -> bool:
        """Whether pitch bias is a state of the chosen model."""
        if self.has_velocity_states or self.pitch_bias is False:
            return False
        return self.mechanization.three_d


def _one_of(name: str, found: str, known: tuple[str, ...]) -> None:
    if found not in known:
        raise ConfigError(f"EkfOptions.{name}: found {found!r}; choose among {', '.join(known)}")
