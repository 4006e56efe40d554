"""Spec of a model of each satellite's residual range error, for partial outages."""

from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from navlearn.recipe.spec_base import Count, NotNegative, Positive, SafeguardSpec, Seed, SpecBase

if TYPE_CHECKING:
    from navlearn.learning.range_error_options import RangeErrorOptions

MARGIN: Final = 0.05
"""Least improvement that the gate asks for."""

OWN: Final[dict[str, dict[str, Any]]] = {
    "pci": {"lags": 4, "window_s": 900.0},
    "fos": {"lags": 1, "output_lags": 2},
    "anarx": {"lags": 2},
    "held": {"inputs": (), "average_s": 300.0, "window_s": 900.0},
    "decay": {"inputs": (), "window_s": 900.0},
    "none": {"inputs": (), "wider_m": 3.0},
}
"""What takes the place of the defaults, by structure."""

SAID: Final = {
    "pci": "parallel cascades learned of each satellite's residual",
    "fos": "a polynomial chosen by FOS learned of each satellite's residual",
    "anarx": "an ANARX network learned of each satellite's residual",
    "held": "each satellite left on average",
    "decay": "a Gauss-Markov process fitted to each satellite's residual decays to",
}


class RangeErrorSpec(SpecBase):
    """The residual range error of each satellite, taken off while few satellites are left.

    Keys left out are those of the ``structure``.

    Attributes:
        type: Kind of model.
        safeguard: When a correction is trusted.
        structure: ``pci`` ([Iqbal2020] §IX), ``fos`` or ``anarx``; ``held`` keeps the mean of the
            last residuals, ``decay`` predicts a Gauss–Markov process, and ``none`` takes nothing
            off; these have no inputs.
        inputs: Names of :data:`navlearn.learning.range_residuals.CHANNELS`, or of ``HELD`` there:
            a model with one of those learns from emulated outages within its window.
        min_satellites: So many satellites must be tracked for a residual to be learned from; the
            model acts where fewer stay visible.
        shared: Whether all satellites share a model, or each has its own.
        window_s: Length of the past that is learned from, s.
        step_s: Length of a row, s; longer where ranges come less often.
        lags: Inputs enter with lags 0 to this; for ``anarx`` its number of lags.
        output_lags: Outputs enter with lags 1 to this (``fos``).
        degree: Degree of the polynomials.
        most: Most cascades or terms.
        hidden: Hidden units per lag (``anarx``).
        acceptance: ``paper`` asks of a cascade or term that it takes 4 over the number of rows of
            what is left, ``default`` that it takes more than the best of white noise would.
        average_s: Time constant of the mean that the input ``recent`` is and ``held`` holds; 0
            holds the last residual alone.
        emulated_s: Length of emulated outages within the window, and of free runs of ``anarx``.
        fewest_rows: A satellite with fewer residuals in the window is left as it is.
        gate_horizon_s: Length of the emulated partial outages that judge the model.
        gate_every_s: Least time between their starts.
        gate_replays: Most recent ones looked at.
        wider_m: Deviation, m, by which a range is known less well while the model acts, squared
            and added to what the receiver tells: an error that stays alike for a minute is no
            white noise, of which a filter would take a minute's mean.
        seed: Seed of everything drawn.
    """

    type: Literal["range_error"] = "range_error"
    safeguard: SafeguardSpec = SafeguardSpec(output_limit=3.0, gate_margin=MARGIN)
    structure: Literal["pci", "fos", "anarx", "held", "decay", "none"]
    inputs: tuple[str, ...] = ("elevation", "cn0")
    min_satellites: Annotated[int, Field(ge=4)] = 5
    shared: bool = False
    window_s: Positive = 300.0
    step_s: Positive = 1.0
    lags: Annotated[int, Field(ge=0)] = 0
    output_lags: Annotated[int, Field(ge=0)] = 0
    degree: Count = 2
    most: Count = 8
    hidden: Count = 3
    acceptance: Literal["default", "paper"] = "default"
    average_s: NotNegative = 60.0
    emulated_s: Positive = 60.0
    fewest_rows: Count = 60
    gate_horizon_s: Positive = 60.0
    gate_every_s: Positive = 30.0
    gate_replays: Count = 12
    wider_m: NotNegative = 0.0
    seed: Seed = 0

    @model_validator(mode="before")
    @classmethod
    def _own_defaults(cls, content: Any) -> Any:
        if not isinstance(content, dict):
            return content
        return {**OWN.get(str(content.get("structure")), {}), **content}

    @model_validator(mode="after")
    def _options_go_together(self) -> "RangeErrorSpec":
        options = self.range_error_options()
        if self.structure == "fos":
            options.fos_options()
        if self.structure == "pci":
            options.pci_options()
        return self

    def range_error_options(self) -> "RangeErrorOptions":
        """Return what is learned, as the options of its room."""
        from navlearn.learning.range_error_options import RangeErrorOptions

        return RangeErrorOptions(
            structure=self.structure,
            inputs=self.inputs,
            min_satellites=self.min_satellites,
            shared=self.shared,
            window_s=self.window_s,
            step_s=self.step_s,
            lags=self.lags,
            output_lags=self.output_lags,
            degree=self.degree,
            most=self.most,
            hidden=self.hidden,
            acceptance=self.acceptance,
            average_s=self.average_s,
            emulated_s=self.emulated_s,
            fewest_rows=self.fewest_rows,
            bounds=self.safeguard.bounds,
            output_limit=self.safeguard.output_limit,
            seed=self.seed,
        )

    def describe(self) -> str:
        """Return what the method of this model does, in a sentence for the report."""
        wider = f", each known {self.wider_m:g} m less well" if self.wider_m else ""
        taken = "as they are"
        if self.structure in SAID:
            taken = f"less what {SAID[self.structure]} over the last {self.window_s:g} s"
        return (
            f"`tc_ekf` on ranges {taken}{wider}, where fewer than {self.min_satellites} "
            "satellites are left"
        )

    @property
    def seeds(self) -> dict[str, int]:
        """Seeds of everything that it draws, by name."""
        return {self.name: self.seed} if self.structure in ("pci", "anarx") else {}
