"""Choices of a search for noise, and of the figures that come with it."""

import math
from dataclasses import dataclass, field

from navlearn.errors import ConfigError
from navlearn.fusion.innovation_likelihood import LikelihoodOptions


@dataclass(frozen=True, kw_only=True)
class TuningOptions:
    """How noise is searched for.

    Attributes:
        free: Names of what is tuned, see
            :func:`navlearn.learning.noise_parameters.known_names`; None for the usual ones.
        prior_factor: How far an entry may well be from where it starts, as a factor of one
            standard deviation: what a drive does not tell stays where it was.
        rounds: How often at most the gate's verdicts are renewed.
        iterations: Steps at the most, all rounds together.
        tolerance: A step that gains less, in nats, ends a round; a round that gains less ends
            the search.
        longest_step: Longest step of any entry, in its logarithm.
        window: Length of stretches that are taken for independent of each other, s.
        minutes: Time after which no further step is begun.
        likelihood: How innovations are judged.
    """

    free: tuple[str, ...] | None = None
    prior_factor: float = 10.0
    rounds: int = 6
    iterations: int = 80
    tolerance: float = 0.1
    longest_step: float = 1.0
    window: float = 60.0
    minutes: float = math.inf
    likelihood: LikelihoodOptions = field(default_factory=LikelihoodOptions)

    def __post_init__(self) -> None:
        """Refuse what no search can do.

        Raises:
            ConfigError: A figure lies outside its range.
        """
        if not 1.0 < self.prior_factor < math.inf:
            raise ConfigError(
                f"TuningOptions.prior_factor: found {self.prior_factor}; expected a factor above 1"
            )
        for name in ("rounds", "iterations", "tolerance", "longest_step", "window", "minutes"):
            if not getattr(self, name) > 0:
                raise ConfigError(
                    f"TuningOptions.{name}: found {getattr(self, name)}; expected more than 0"
                )
