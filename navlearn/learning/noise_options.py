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
        spacing: Only fixes at least so far apart take part, s; 0 for all of them. The filter runs
            on those alone, so that errors of fixes that last count once, and the noise of motion
            is judged over as many seconds. What R would be told then is the error of one fix by
            itself. The filter that navigates takes all fixes, and its R must also tell how little
            many fixes with the same error say together; so with a spacing the entries of R
            (:data:`navlearn.learning.noise_parameters.FIX_ENTRIES`) stay as they are unless
            ``free`` names them.
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
    spacing: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no search can do.

        Raises:
            ConfigError: A figure lies outside its range.
        """
        if not 1.0 < self.prior_factor < math.inf:
            raise ConfigError(
                f"TuningOptions.prior_factor: found {self.prior_factor}; expected a factor above 1"
            )
        if not 0.0 <= self.spacing < math.inf:
            raise ConfigError(
                f"TuningOptions.spacing: found {self.spacing}; expected seconds, 0 or more"
            )
        for name in ("rounds", "iterations", "tolerance", "longest_step", "window", "minutes"):
            if not getattr(self, name) > 0:
                raise ConfigError(
                    f"TuningOptions.{name}: found {getattr(self, name)}; expected more than 0"
                )
