"""What a tightly coupled filter leaves behind."""

from typing import Any, NamedTuple

from torch import Tensor

from navlearn.filters.tight_belief import TightBelief
from navlearn.states import InsState, Trajectory


class TightHistory(NamedTuple):
    """A tightly coupled filter's run: B drives, K blocks, S satellites, r rows of the vehicle.

    Attributes:
        end: Last sample of each block, int64, shape (B, K).
        reception: Reception of ranges at the end of each block, int64, −1 for none, shape (B, K).
        prior: Belief before the update at the block's end, batch shape (B, K).
        belief: Belief after it, batch shape (B, K).
        trajectory: Causal solution at full rate, batch shape (B, T).
        innovation: Measured minus predicted of each pseudorange, m, NaN where there is none, shape
            (B, K, S).
        rate_innovation: The same of range rates, m/s.
        residual: Measured minus what the belief after the update says of each pseudorange, m, those
            refused included, NaN where there is none, shape (B, K, S).
        spread: Variance of the innovation of each pseudorange, m², shape (B, K, S).
        nis: Normalised innovation squared of each pseudorange, then of each range rate, shape
            (B, K, 2 S).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, in the same order.
        own_innovation: Innovation of what the vehicle measures of itself, shape (B, K, r).
        own_nis: Its NIS per kind.
        own_verdict: Its verdict per kind.
        resets: How often position and clock were begun anew, and the clock alone, shape (B, 2).
        method: The form that computed this.
        passes: Passes of the fast form; 1 for the others.
    """

    end: Tensor
    reception: Tensor
    prior: TightBelief[Any]
    belief: TightBelief[Any]
    trajectory: Trajectory | InsState
    innovation: Tensor
    rate_innovation: Tensor
    residual: Tensor
    spread: Tensor
    nis: Tensor
    verdict: Tensor
    own_innovation: Tensor
    own_nis: Tensor
    own_verdict: Tensor
    resets: Tensor
    method: str
    passes: int
