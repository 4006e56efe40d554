"""Spec of gyro error terms as states of the filter."""

import dataclasses
import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from navlearn.recipe.spec_base import NotNegative, Positive, SafeguardSpec, SpecBase

if TYPE_CHECKING:
    from navlearn.fusion.options import EkfOptions

GyroTerm = Literal["bias", "scale", "abs_scale", "quadratic", "f_x", "f_y", "temperature"]

OF_TURNING = ("scale", "abs_scale", "quadratic")
"""Terms that explain what the honest filter books as noise of turning."""


class AugmentedSpec(SpecBase):
    """A filter that estimates more of the gyro's errors than its bias.

    How large the terms may be is told by ``initial.gyro`` of the recipe's filter section.

    Attributes:
        type: Kind of model.
        gyro_terms: Gyro error terms that are estimated; regressors 1, ω, |ω|, ω|ω|, f_x, f_y, and
            the sensor's temperature above that at the start, for a log that tells it.
        turn_noise: What turning adds to the azimuth that no term explains, √s; the filter's own
            where that is smaller, or where no term depends on turning.
        temperature_deg_per_s_per_k: How large the effect of temperature may be.
        standstill_s: Shortest standstill that observes the terms.
        judge_s: Length of the emulated outages that judge the model.
        judge_every_s: Time between their starts.
        judge_after_s: None starts earlier after the alignment.
        safeguard: When the model is trusted. There are no bounds to keep: what a state says is
            bounded by its prior.
    """

    type: Literal["augmented"] = "augmented"
    gyro_terms: Annotated[tuple[GyroTerm, ...], Field(min_length=1)] = (
        "bias",
        "scale",
        "abs_scale",
        "quadratic",
        "f_x",
        "f_y",
        "temperature",
    )
    turn_noise: NotNegative = 0.003
    temperature_deg_per_s_per_k: Positive = 0.01
    standstill_s: Positive = 1.0
    judge_s: Positive = 60.0
    judge_every_s: Positive = 10.0
    judge_after_s: NotNegative = 60.0
    safeguard: SafeguardSpec = SafeguardSpec(gate_margin=0.02)

    @model_validator(mode="after")
    def _terms_make_a_filter(self) -> "AugmentedSpec":
        if len(set(self.gyro_terms)) != len(self.gyro_terms):
            raise ValueError(f"gyro_terms are {list(self.gyro_terms)}; name each term once")
        if "bias" not in self.gyro_terms:
            raise ValueError(
                f"gyro_terms are {list(self.gyro_terms)}; add 'bias', which no gyro is without"
            )
        return self

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        return f"the filter with gyro error terms {', '.join(self.gyro_terms)}"

    @property
    def thermal(self) -> bool:
        """Whether the effect of temperature is estimated."""
        return "temperature" in self.gyro_terms

    @property
    def temperature_prior(self) -> float:
        """How large the effect of temperature may be, rad/s per K."""
        return math.radians(self.temperature_deg_per_s_per_k)

    def filter_options(self, honest: "EkfOptions") -> "EkfOptions":
        """Return the options of the filter that has these terms as states, but temperature.

        Args:
            honest: Options of the filter without them.
        """
        noise = honest.noise
        if any(term in OF_TURNING for term in self.gyro_terms):
            quiet = min(noise.turn_noise, self.turn_noise)
            noise = dataclasses.replace(noise, turn_noise=quiet)
        return dataclasses.replace(
            honest,
            gyro_terms=tuple(term for term in self.gyro_terms if term != "temperature"),
            standstill=self.standstill_s,
            noise=noise,
        )
