"""Options of parallel cascade identification, as plain data."""

from dataclasses import dataclass
from typing import Any

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class PciOptions:
    """How a parallel cascade model is built.

    The four limits ``cascades``, ``tried``, ``target`` and ``misses`` are the four stopping rules
    of [Iqbal2020], whose model is :meth:`paper`.

    Attributes:
        inputs: Number of input channels m.
        lags: Largest lag R; the memory is R + 1 samples.
        degree: Degree D of the static polynomials.
        order: Highest order of the cross-correlations drawn, 1 to 3.
        batch: Candidates per round, of which the best that passes is added.
        cascades: Stops after that many cascades.
        tried: Stops before more candidates than this were tried.
        misses: Stops after that many batches in a row of which no candidate passed.
        target: Stops when the mean squared residual falls to it, standardised units.
        acceptance: ``default`` (error rate held over the batch) or ``paper`` (4 / rows).
        level: Chance that ``default`` accepts any of a batch on white noise.
        refit: Fits all polynomials together after every new cascade; the paper does not.
        polish: Most steps that move all responses together after every new cascade; the paper has
            none.
        safeguard: Clamps inputs and linear outputs to their training range, limits the output.
        output_limit: Limit of the output about its training mean, in training standard
            deviations.
        seed: Seed of orders, lags, channels and signs.
    """

    inputs: int = 1
    lags: int = 10
    degree: int = 3
    order: int = 3
    batch: int = 64
    cascades: int = 20
    tried: int = 10_000
    misses: int = 1
    target: float = 1e-12
    acceptance: str = "default"
    level: float = 0.02
    refit: bool = True
    polish: int = 10
    safeguard: bool = True
    output_limit: float = 5.0
    seed: int = 0

    @classmethod
    def paper(cls, **changed: Any) -> "PciOptions":
        """Return the model of [Iqbal2020]: one candidate at a time, never fitted again.

        When to call a record exhausted is left open there; here after 20 candidates in a row.

        Args:
            changed: Options that differ from theirs.
        """
        theirs: dict[str, Any] = {
            "lags": 10,
            "degree": 3,
            "cascades": 8,
            "batch": 1,
            "misses": 20,
            "acceptance": "paper",
            "refit": False,
            "polish": 0,
            "safeguard": False,
        }
        return cls(**{**theirs, **changed})

    def __post_init__(self) -> None:
        for name in ("inputs", "degree", "batch", "cascades", "tried", "misses"):
            if getattr(self, name) < 1:
                raise ConfigError(f"pci: {name} is {getattr(self, name)}; it must be at least 1")
        for name in ("lags", "polish"):
            if getattr(self, name) < 0:
                raise ConfigError(f"pci: {name} is {getattr(self, name)}; it must not be negative")
        if self.polish and not self.refit:
            raise ConfigError("pci: polish moves all cascades together, which needs refit=True")
        if self.order not in (1, 2, 3):
            raise ConfigError(f"pci: order is {self.order}; choose 1, 2 or 3")
        if self.acceptance not in ("default", "paper"):
            raise ConfigError(f"pci: acceptance {self.acceptance!r}; choose default or paper")
        if not 0.0 < self.level < 1.0:
            raise ConfigError(f"pci: level is {self.level}; it must lie between 0 and 1")
        if not self.target >= 0.0:
            raise ConfigError(f"pci: target is {self.target}; it must not be negative")
        if not self.output_limit > 0.0:
            raise ConfigError(f"pci: output_limit is {self.output_limit}; it must be positive")
