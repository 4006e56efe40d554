"""Shape of an ANARX network, as plain data."""

from dataclasses import dataclass

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class AnarxOptions:
    """Shape of an ANARX network.

    Attributes:
        inputs: Number of regressors m.
        outputs: Number of outputs p.
        lags: Number of lags n, each with a hidden layer of its own.
        hidden: Hidden units per lag.
        activation: ``sigmoid`` or ``tanh``.
        linear_path: Adds a direct linear term per lag; the paper has none.
        safeguard: Clamps inputs to their training range and limits outputs.
        output_limit: Limit of an output about its training mean, in training standard deviations.
    """

    inputs: int
    outputs: int = 1
    lags: int = 2
    hidden: int = 5
    activation: str = "sigmoid"
    linear_path: bool = True
    safeguard: bool = True
    output_limit: float = 5.0

    def __post_init__(self) -> None:
        for name in ("inputs", "outputs", "lags", "hidden"):
            if getattr(self, name) < 1:
                raise ConfigError(f"anarx: {name} is {getattr(self, name)}; it must be at least 1")
        if self.activation not in ("sigmoid", "tanh"):
            raise ConfigError(f"anarx: activation {self.activation!r}; choose sigmoid or tanh")
        if not self.output_limit > 0.0:
            raise ConfigError(f"anarx: output_limit is {self.output_limit}; it must be positive")
