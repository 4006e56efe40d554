"""The two steps of a tightly coupled filter's loop: how it predicts, and how it sees."""

from typing import Any, NamedTuple, Protocol

from torch import Tensor

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.prediction import TightAhead, tight_ahead
from navlearn.fusion.tight.seen import See, seen_linearly


class Ahead(Protocol):
    """How a filter predicts: :func:`navlearn.fusion.tight.prediction.tight_ahead` or its like."""

    def __call__(  # noqa: D102
        self,
        model: TightModel,
        belief: TightBelief[Any],
        block: Any,
        elapsed: Tensor,
        noise: TightNoise,
        *,
        in_turn: bool = False,
    ) -> TightAhead: ...


class TightSteps(NamedTuple):
    """How a filter predicts and sees.

    Attributes:
        ahead: Prediction over blocks.
        see: What is measured at their ends.
    """

    ahead: Ahead
    see: See


LINEAR = TightSteps(tight_ahead, seen_linearly)
"""The steps of the extended filter."""
