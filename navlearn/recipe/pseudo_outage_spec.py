"""Spec of a gyro-rate error model learned from emulated outages, outside any filter."""

from typing import Literal

from navlearn.recipe.spec_base import SpecBase

STRUCTURES = {"ridge": "physical terms", "fos": "terms chosen by FOS", "pci": "cascades of PCI"}


class PseudoOutageSpec(SpecBase):
    """A gyro-rate error regressed on what azimuth would have been off by in past outages.

    Attributes:
        type: Kind of model.
        structure: Where its regressors come from: ``ridge`` takes the physical terms, ``fos``
            and ``pci`` find them.
    """

    type: Literal["pseudo_outage"] = "pseudo_outage"
    structure: Literal["ridge", "fos", "pci"] = "ridge"

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        return (
            "the honest filter on a gyro corrected by a regression on emulated outages "
            f"({STRUCTURES[self.structure]})"
        )
