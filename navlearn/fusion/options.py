"""What a user may choose about the loosely coupled filter."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Literal

from navlearn.errors import ConfigError
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.noise_options import InitialOptions, NoiseOptions
from navlearn.mechanization.options import RissOptions

GYRO_TERMS = ("bias", "scale", "abs_scale", "quadratic", "f_x", "f_y")
SPEED_TERMS = ("scale", "delay", "offset")
MODELS = ("bias_scale", "shen2010", "shen2010_full", "bias_free")


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
        unscented: Sigma points of the unscented filter; None is the extended one.
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
    unscented: UnscentedOptions | None = None
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
        for entry in fields(self.noise):
            value = getattr(self.noise, entry.name)
            if not 0.0 <= value < math.inf:
                raise ConfigError(
                    f"NoiseOptions.{entry.name}: found {value}; expected a finite value >= 0"
                )
        for entry in fields(self.initial):
            value = getattr(self.initial, entry.name)
            terms = value if isinstance(value, Mapping) else {"": value}
            for term, one in terms.items():
                if not 0.0 <= one < math.inf:
                    named = f"{entry.name}.{term}" if term else entry.name
                    raise ConfigError(
                        f"InitialOptions.{named}: found {one}; expected a finite value >= 0"
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
