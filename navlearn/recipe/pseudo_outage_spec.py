"""Spec of a gyro-rate error model learned from emulated outages, outside any filter."""

import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, model_validator

from navlearn.recipe.spec_base import Count, NotNegative, Positive, SafeguardSpec, Seed, SpecBase

if TYPE_CHECKING:
    from navlearn.learning.gyro_past import GyroRateOptions

STRUCTURES = {"ridge": "physical terms", "fos": "terms chosen by FOS", "pci": "cascades of PCI"}

Terms = Annotated[tuple[str, ...], Field(min_length=1)]


class PseudoOutageSpec(SpecBase):
    """A gyro-rate error regressed on what azimuth would have been off by in past outages.

    Attributes:
        type: Kind of model.
        structure: Where its regressors come from: ``ridge`` takes the physical terms, ``fos``
            and ``pci`` find them.
        terms: Terms of ``ridge``: products of one or two channels of
            :data:`navlearn.error_models.regressors.CHANNELS` or, written ``abs_`` before the
            name, of their magnitudes, joined by ``*``.
        factors: Channels and magnitudes of whose products ``fos`` chooses, and channels among
            which ``pci`` finds its cascades.
        degree: Largest degree of a product of ``fos``.
        power: Degree of the polynomials of ``pci``.
        max_terms: Most terms of ``fos``, most cascades of ``pci``.
        false_alarm: Chance that white noise alone has a term or cascade accepted.
        structure_every_s: Longest time that found terms serve in the judging before others are
            looked for; for the outage itself they are always looked for.
        other_prior_deg_per_s: Error that a term without a prior of its own is expected to make
            at its root mean square, deg/s.
        average_s: Longest time over which channels are averaged before terms are formed.
        random_walk_deg_per_sqrt_h: Angle random walk of the gyro.
        bias_walk_deg_per_h_per_sqrt_h: Random walk of the gyro bias.
        turn_noise: What turning adds to the azimuth that no term explains, √s.
        fix_variance: Factor on the variance that the filter gives what a fix told of the azimuth.
        restart: Where azimuth and gyro bias at the outage's start come from: ``filter`` runs the
            filter again over the last minutes with the corrected gyro, ``regression`` takes those
            of the regression itself. The gate judges by those of the regression either way.
        refilter_s: The filter runs again over so much of the past with the corrected gyro.
        judge_s: Length of the emulated outages that judge the model.
        judge_every_s: Time between their starts.
        judge_after_s: None starts earlier in the filter's run.
        seed: Seed of the cascades that ``pci`` tries.
        safeguard: When the correction is trusted.
    """

    type: Literal["pseudo_outage"] = "pseudo_outage"
    structure: Literal["ridge", "fos", "pci"] = "ridge"
    terms: Terms = ("yaw_rate", "abs_yaw_rate", "yaw_rate*abs_yaw_rate", "f_x", "f_y")
    factors: Terms = ("yaw_rate", "abs_yaw_rate", "f_x", "f_y", "speed", "acceleration")
    degree: Literal[1, 2] = 2
    power: Annotated[int, Field(ge=1, le=5)] = 3
    max_terms: Count = 6
    false_alarm: Annotated[float, Field(gt=0, le=1)] = 0.05
    structure_every_s: Positive = 240.0
    other_prior_deg_per_s: Positive = 0.05
    average_s: Positive = 0.1
    random_walk_deg_per_sqrt_h: Positive = 0.6
    bias_walk_deg_per_h_per_sqrt_h: NotNegative = 60.0
    turn_noise: NotNegative = 0.003
    fix_variance: Positive = 0.4
    restart: Literal["filter", "regression"] = "regression"
    refilter_s: Positive = 600.0
    judge_s: Positive = 60.0
    judge_every_s: Positive = 30.0
    judge_after_s: NotNegative = 240.0
    seed: Seed = 0
    safeguard: SafeguardSpec = SafeguardSpec(output_limit=15.0, gate_margin=0.03)

    @model_validator(mode="after")
    def _terms_are_known(self) -> "PseudoOutageSpec":
        from navlearn.error_models.gyro_terms import channels_of
        from navlearn.error_models.regressors import CHANNELS

        for name in (*self.terms, *self.factors):
            for channel in channels_of((name,)):
                if channel not in CHANNELS:
                    raise ValueError(
                        f"{name!r} is made of {channel!r}; known: {', '.join(CHANNELS)}"
                    )
        for name in self.terms:
            if name.count("*") > 1:
                raise ValueError(f"the term {name!r} has more than two factors; give one or two")
        if self.structure == "pci" and self.false_alarm == 1.0:
            raise ValueError("pci asks for a false_alarm below 1")
        for name in self.factors:
            if "*" in name:
                raise ValueError(f"the factor {name!r} is a product; list its factors alone")
            if self.structure == "pci" and name not in CHANNELS:
                raise ValueError(f"pci takes channels: {name!r} is none of {', '.join(CHANNELS)}")
        return self

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        return (
            "the honest filter on a gyro corrected by a regression on emulated outages "
            f"({STRUCTURES[self.structure]})"
        )

    @property
    def seeds(self) -> dict[str, int]:
        """Seeds of everything that it draws, by name."""
        return {self.name: self.seed} if self.structure == "pci" else {}

    def options(self) -> "GyroRateOptions":
        """Return how the model is learned."""
        from navlearn.learning.azimuth_regression import AzimuthNoise
        from navlearn.learning.gyro_past import GyroRateOptions

        noise = AzimuthNoise(
            gyro_random_walk=math.radians(self.random_walk_deg_per_sqrt_h) / 60.0,
            turn_noise=self.turn_noise,
            gyro_bias_walk=math.radians(self.bias_walk_deg_per_h_per_sqrt_h) / 3600.0 / 60.0,
        )
        return GyroRateOptions(
            structure=self.structure,
            terms=self.terms,
            factors=self.factors,
            degree=self.degree,
            power=self.power,
            structure_every=self.structure_every_s,
            max_terms=self.max_terms,
            false_alarm=self.false_alarm,
            other_prior=math.radians(self.other_prior_deg_per_s),
            average=self.average_s,
            noise=noise,
            fix_variance=self.fix_variance,
            seed=self.seed,
            safeguard=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
        )
