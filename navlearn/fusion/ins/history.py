"""What a full-IMU filter leaves behind: its beliefs at every update, and the path between them."""

from typing import NamedTuple

from torch import Tensor

from navlearn.filters.ins_belief import InsBelief
from navlearn.states import InsState


class InsHistory(NamedTuple):
    """A filter's run over a batch of drives; K counts blocks, r rows, kinds as in ``InsKind``.

    Attributes:
        end: Last sample of each block, int64, shape (B, K). Blocks that pad a shorter drive
            repeat its last sample.
        fix: Fix at the end of each block, int64, −1 for none, shape (B, K).
        prior: Belief before the update at the block's end, batch shape (B, K).
        belief: Belief after it, batch shape (B, K).
        trajectory: Causal solution at full rate, shape (B, T) and (B, T, 3), (B, T, 4): predicted
            inside blocks, corrected at a block's last sample.
        innovation: Measured minus predicted, NaN where nothing was measured, shape (B, K, r).
        nis: Normalised innovation squared per kind, NaN where nothing was measured,
            shape (B, K, 6).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, shape (B, K, 6).
        resets: How often the gate was reset, shape (B, 6).
        error: Error of the free mechanization as estimated after the update, shape (B, K, n);
            zero in a closed loop, which has fed it back.
        method: The form that computed this; ``exact`` where ``fast`` did not converge.
        passes: Passes of the fast form over all blocks; 1 for the others.
    """

    end: Tensor
    fix: Tensor
    prior: InsBelief
    belief: InsBelief
    trajectory: InsState
    innovation: Tensor
    nis: Tensor
    verdict: Tensor
    resets: Tensor
    error: Tensor
    method: str
    passes: int
