"""What a filter leaves behind: its beliefs at every update, and the path between them."""

from typing import NamedTuple

from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.states import Trajectory


class FilterHistory(NamedTuple):
    """A filter's run over a batch of drives; K counts blocks, r rows, kinds as in ``Kind``.

    Attributes:
        end: Last sample of each block, int64, shape (B, K). Blocks that pad a shorter drive
            repeat its last sample.
        fix: Fix at the end of each block, int64, −1 for none, shape (B, K).
        prior: Belief before the update at the block's end, batch shape (B, K).
        belief: Belief after it, batch shape (B, K).
        trajectory: Causal solution at full rate, shape (B, T) each: predicted inside blocks,
            position and azimuth corrected at a block's last sample; velocity as predicted.
        innovation: Measured minus predicted, NaN where nothing was measured, shape (B, K, r).
        nis: Normalised innovation squared per kind, NaN where nothing was measured,
            shape (B, K, 5).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, shape (B, K, 5).
        resets: How often the gate was reset, shape (B, 5).
        error: Error of the free mechanization as estimated after the update, shape (B, K, n);
            zero in a closed loop, which has fed it back.
        method: The form that computed this; ``exact`` where ``fast`` did not converge.
        passes: Passes of the fast form over all blocks; 1 for the others.
    """

    end: Tensor
    fix: Tensor
    prior: Belief
    belief: Belief
    trajectory: Trajectory
    innovation: Tensor
    nis: Tensor
    verdict: Tensor
    resets: Tensor
    error: Tensor
    method: str
    passes: int
