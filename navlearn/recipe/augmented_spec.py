"""Spec of gyro error terms as states of the filter."""

from typing import Literal

from navlearn.recipe.spec_base import SpecBase


class AugmentedSpec(SpecBase):
    """A filter that estimates more of the gyro's errors than its bias.

    Attributes:
        type: Kind of model.
        gyro_terms: Gyro error terms that are states; regressors 1, ω, |ω|, ω|ω|, f_x, f_y.
    """

    type: Literal["augmented"] = "augmented"
    gyro_terms: tuple[Literal["bias", "scale", "abs_scale", "quadratic", "f_x", "f_y"], ...] = (
        "bias",
        "scale",
        "abs_scale",
        "quadratic",
        "f_x",
        "f_y",
    )

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        return f"the filter with gyro error states {', '.join(self.gyro_terms)}"
