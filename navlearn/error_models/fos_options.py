"""What FOS searches and when it stops, as plain data."""

from dataclasses import dataclass

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class FosOptions:
    """What FOS searches and when it stops.

    Attributes:
        lags: Inputs enter with lags 0 to this.
        output_lags: Outputs enter with lags 1 to this; 0 for none.
        degree: Largest degree of a candidate, 1 or 2.
        max_terms: Most terms of a model.
        acceptance: What a term must take of the residual: ``default`` (more than the best of all
            candidates takes of white noise) or ``paper`` (4 over the number of rows).
        false_alarm: For ``default``, the chance that white noise alone has a term accepted; 1
            switches the rule off.
        target_error: Weighted RMS residual that is good enough, unit of the target.
        ridge: Penalty on each coefficient, as a share of its candidate's own energy; the
            constant goes free.
        exchange_sweeps: Most sweeps that try to swap every term for a better candidate.
        kicks: Times that three terms, drawn at random, are dropped, searched and exchanged anew;
            kept where the residual has less energy for it.
        seed: Seed of what the kicks draw.
        backward: After the search, drops terms that the rule would not accept.
        collinearity: A candidate whose share of energy left outside the chosen terms is below
            this is not considered.
        safeguard: Clamps inputs to their training range and limits outputs.
        output_limit: Limit of an output about its training mean, in training standard deviations.
    """

    lags: int = 1
    output_lags: int = 0
    degree: int = 2
    max_terms: int = 8
    acceptance: str = "default"
    false_alarm: float = 0.01
    target_error: float = 0.0
    ridge: float = 0.0
    exchange_sweeps: int = 0
    kicks: int = 0
    seed: int = 0
    backward: bool = False
    collinearity: float = 1e-8
    safeguard: bool = True
    output_limit: float = 5.0

    def __post_init__(self) -> None:
        for name in ("lags", "output_lags", "exchange_sweeps", "kicks", "target_error", "ridge"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"fos: {name} is {getattr(self, name)}; it must not be negative")
        if self.degree not in (1, 2):
            raise ConfigError(f"fos: degree is {self.degree}; choose 1 or 2")
        if self.max_terms < 1:
            raise ConfigError(f"fos: max_terms is {self.max_terms}; it must be at least 1")
        if self.acceptance not in ("default", "paper"):
            raise ConfigError(
                f"fos: acceptance is {self.acceptance!r}; choose 'default' or 'paper'"
            )
        if not 0.0 < self.false_alarm <= 1.0:
            raise ConfigError(f"fos: false_alarm is {self.false_alarm}; it must lie in (0, 1]")
        if not 0.0 < self.collinearity < 1.0:
            raise ConfigError(f"fos: collinearity is {self.collinearity}; it must lie in (0, 1)")
        if not self.output_limit > 0.0:
            raise ConfigError(f"fos: output_limit is {self.output_limit}; it must be positive")
