"""Spec of the papers' own models of the azimuth error, trained in a sliding window."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from navlearn.recipe.spec_base import Count, Positive, SafeguardSpec, Seed, SpecBase

if TYPE_CHECKING:
    from navlearn.error_models.fos_options import FosOptions
    from navlearn.error_models.pci_options import PciOptions

IQBAL2020: dict[str, Any] = {"inputs": ("azimuth",), "window_s": 300.0, "lags": 10, "degree": 3}
"""What takes the place of the defaults, which are those of [Shen2010], in a spec of PCI."""

MARGIN = 0.25
"""Least improvement that the gate asks for."""


class AzimuthSpec(SpecBase):
    """What a feed-forward filter leaves of the azimuth error, learned over the last minutes.

    Keys left out are those of the paper behind the ``structure``.

    Attributes:
        type: Kind of model.
        safeguard: When a correction is trusted. The gate asks for more than elsewhere: what a
            window of a minute or five teaches varies so much from one emulated outage to the
            next that a useless model gains a fifth on a dozen of them now and then.
        structure: ``pci`` ([Iqbal2020]) or ``fos`` ([Shen2010]).
        filter: The filter that it stands beside, run feed-forward: ``recipe`` is the recipe's
            own, the others are the recipe's with another model of the errors.
        inputs: Errors that the filter predicts, by their names in its error state (``azimuth``,
            ``gyro_bias``, ``east``, ...); none stands for all of them.
        target: What is modelled: the ``angle`` itself, or its ``rate``, which is integrated
            through the outage; both readings of [Shen2010] Eq. (9).
        window_s: Length of the sliding window, s.
        course_speed: Slowest speed at which GNSS course counts as azimuth, m/s.
        lags: Inputs enter with lags 0 to this, in steps of the recipe's ``training.step_s``.
        degree: Degree of the polynomials.
        most: Most terms (``fos``) or cascades (``pci``).
        acceptance: ``paper`` asks of a term or cascade that it takes 4 over the number of rows of
            what is left, ``default`` that it takes more than the best of white noise would;
            ``none`` (of ``fos`` only) takes terms up to ``most``, which [Shen2010] may be read as.
        gate_replays: Most recent emulated outages that the gate looks at.
        seed: Seed of what PCI draws.
    """

    type: Literal["azimuth_window"] = "azimuth_window"
    safeguard: SafeguardSpec = SafeguardSpec(gate_margin=MARGIN)
    structure: Literal["pci", "fos"]
    filter: Literal["recipe", "bias_free", "shen2010", "shen2010_full"] = "recipe"
    inputs: tuple[str, ...] = ()
    target: Literal["angle", "rate"] = "angle"
    window_s: Positive = 60.0
    course_speed: Positive = 5.0
    lags: Annotated[int, Field(ge=0)] = 1
    degree: Count = 2
    most: Count = 8
    acceptance: Literal["paper", "default", "none"] = "paper"
    gate_replays: Count = 12
    seed: Seed = 0

    @model_validator(mode="before")
    @classmethod
    def _as_in_the_paper(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        return {**IQBAL2020, **content} if content.get("structure") == "pci" else content

    @model_validator(mode="after")
    def _options_go_together(self) -> "AzimuthSpec":
        if self.structure == "fos":
            self.fos_options()
        elif self.acceptance == "none":
            raise ValueError("acceptance 'none' belongs to fos; pci takes 'paper' or 'default'")
        else:
            self.pci_options(inputs=1)
        return self

    def fos_options(self) -> "FosOptions":
        """Return the options of the search."""
        from navlearn.error_models.fos_options import FosOptions

        return FosOptions(
            lags=self.lags,
            degree=self.degree,
            max_terms=self.most,
            acceptance="default" if self.acceptance == "none" else self.acceptance,
            false_alarm=1.0 if self.acceptance == "none" else FosOptions.false_alarm,
            safeguard=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
        )

    def pci_options(self, *, inputs: int) -> "PciOptions":
        """Return the options of the cascades.

        Args:
            inputs: Number of inputs.
        """
        from navlearn.error_models.pci_options import PciOptions

        make = PciOptions.paper if self.acceptance == "paper" else PciOptions
        return make(
            inputs=inputs,
            lags=self.lags,
            degree=self.degree,
            cascades=self.most,
            safeguard=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
            seed=self.seed,
        )

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        beside = {"recipe": "the honest filter"}.get(
            self.filter, f"a filter of model {self.filter}"
        )
        return (
            f"mechanization with an azimuth less what {self.structure.upper()} learned of its "
            f"residual ({self.target}) over the last {self.window_s:g} s, beside {beside} run "
            "feed-forward"
        )

    @property
    def seeds(self) -> dict[str, int]:
        """Seeds of everything that it draws, by name."""
        return {self.name: self.seed} if self.structure == "pci" else {}
