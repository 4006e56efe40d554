"""What is learned of range errors, as plain data."""

from dataclasses import dataclass
from typing import Final

from navlearn.error_models.anarx_options import AnarxOptions
from navlearn.error_models.fos_options import FosOptions
from navlearn.error_models.pci_options import PciOptions
from navlearn.errors import ConfigError
from navlearn.learning.options import TrainingOptions
from navlearn.learning.range_residuals import HELD, ResidualOptions

STRUCTURES: Final = ("pci", "fos", "anarx", "held", "decay", "none")


@dataclass(frozen=True, kw_only=True)
class RangeErrorOptions:
    """What is learned of range errors.

    Attributes:
        structure: ``pci``, ``fos`` or ``anarx``; ``held`` keeps the mean of each satellite's last
            residuals, ``decay`` predicts a Gauss–Markov process in white noise, ``none`` nothing.
        inputs: Names of :data:`navlearn.learning.range_residuals.CHANNELS` and of ``HELD`` there;
            the other structures have none.
        min_satellites: Fewest satellites tracked for a residual to be learned from; with fewer
            the model acts.
        shared: Whether one model is fitted to all satellites, or one to each.
        window_s: Length of the past that is learned from, s.
        step_s: Length of a row, s.
        lags: Inputs enter with lags 0 to this; for ``anarx`` the number of lags.
        output_lags: Outputs enter with lags 1 to this (``fos``).
        degree: Degree of the polynomials.
        most: Most cascades or terms.
        hidden: Hidden units per lag (``anarx``).
        acceptance: ``default`` or ``paper``, of cascades and terms.
        average_s: Time constant of the mean that ``recent`` is and ``held`` holds, s; 0 holds the
            last residual alone.
        emulated_s: Length of the emulated outages that a model with inputs of ``HELD`` learns
            from, and of the free runs that ``anarx`` does, s.
        fewest_rows: A satellite with fewer targets in the window is left as it is.
        bounds: Whether inputs are clamped to their training range and corrections limited.
        output_limit: Limit of a correction about its training mean, in training deviations.
        seed: Seed of everything drawn.
    """

    structure: str = "pci"
    inputs: tuple[str, ...] = ("elevation", "cn0")
    min_satellites: int = 5
    shared: bool = False
    window_s: float = 300.0
    step_s: float = 1.0
    lags: int = 0
    output_lags: int = 0
    degree: int = 2
    most: int = 8
    hidden: int = 3
    acceptance: str = "default"
    average_s: float = 60.0
    emulated_s: float = 60.0
    fewest_rows: int = 60
    bounds: bool = True
    output_limit: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.structure not in STRUCTURES:
            raise ConfigError(
                f"range errors: structure {self.structure!r}; choose one of {', '.join(STRUCTURES)}"
            )
        for name in ("window_s", "emulated_s"):
            if not getattr(self, name) >= self.step_s:
                raise ConfigError(
                    f"range errors: {name} is {getattr(self, name)} s; it must be at least a step "
                    f"of {self.step_s} s"
                )
        if not self.average_s >= 0.0 or (self.held_inputs and self.average_s == 0.0):
            raise ConfigError(
                f"range errors: average_s is {self.average_s} s; it must not be negative, and the "
                "input recent is a mean over more than 0 s"
            )
        if self.structure == "anarx" and self.held_inputs:
            raise ConfigError(
                f"range errors: anarx feeds its own output back; {', '.join(self.held_inputs)} "
                "belong to pci and fos"
            )
        if self.structure in ("pci", "fos", "anarx") and not self.inputs:
            raise ConfigError(f"range errors: {self.structure} needs at least one input")
        if self.output_lags and (self.structure != "fos" or self.held_inputs):
            raise ConfigError(
                "range errors: output_lags belong to fos without inputs recent and delay"
            )
        self.residual_options()

    @property
    def held_inputs(self) -> tuple[str, ...]:
        """Inputs that only exist in an outage, in their order."""
        return tuple(name for name in self.inputs if name in HELD)

    def residual_options(self) -> ResidualOptions:
        """Return what is put on the grid."""
        learns = self.structure in ("pci", "fos", "anarx")
        seen = tuple(name for name in self.inputs if name not in HELD) if learns else ()
        return ResidualOptions(
            inputs=seen,
            min_satellites=self.min_satellites,
            step=self.step_s,
        )

    def pci_options(self) -> PciOptions:
        """Return the options of the cascades."""
        make = PciOptions.paper if self.acceptance == "paper" else PciOptions
        return make(
            inputs=len(self.inputs),
            lags=self.lags,
            degree=self.degree,
            cascades=self.most,
            tried=1000,
            safeguard=self.bounds,
            output_limit=self.output_limit,
            seed=self.seed,
        )

    def fos_options(self) -> FosOptions:
        """Return the options of the search."""
        return FosOptions(
            lags=self.lags,
            output_lags=self.output_lags,
            degree=self.degree,
            max_terms=self.most,
            acceptance=self.acceptance,
            safeguard=self.bounds,
            output_limit=self.output_limit,
        )

    def anarx_options(self) -> AnarxOptions:
        """Return the shape of the network."""
        return AnarxOptions(
            inputs=len(self.inputs),
            lags=max(self.lags, 1),
            hidden=self.hidden,
            safeguard=self.bounds,
            output_limit=self.output_limit,
        )

    def training_options(self) -> TrainingOptions:
        """Return how the network is trained."""
        return TrainingOptions(
            max_iterations=15, starts=1, start_iterations=5, ridge=1e-2, seed=self.seed
        )
