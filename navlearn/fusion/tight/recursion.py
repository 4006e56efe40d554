"""The tightly coupled filter as a loop over blocks: predict one, update at its end, go on."""

from typing import Any

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.recursion import stacked, unstacked
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.prediction import predicted_belief, tight_ahead
from navlearn.fusion.tight.record import tight_history
from navlearn.fusion.tight.timeline import TightLine
from navlearn.fusion.tight.update import TightEnded, updated
from navlearn.fusion.tight.vehicle import blocks_in_turn


def run_tight_loop(
    model: TightModel,
    start: TightBelief[Any],
    line: TightLine,
    noise: TightNoise,
    *,
    in_turn: bool = False,
) -> TightHistory:
    """Run the filter block after block.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise of ranges and clock.
        in_turn: Whether a block's samples are taken one after another, not at once.

    Returns:
        History.
    """
    belief, ends = start, list[TightEnded]()
    pairs = zip(blocks_in_turn(model.vehicle, line.vehicle), unstacked(line.reception), strict=True)
    for block, reception in pairs:
        ahead = tight_ahead(model, belief, block, reception.elapsed, noise, in_turn=in_turn)
        prior = predicted_belief(ahead, belief.covariance)
        ended = updated(model, prior, block, reception, noise)
        belief = ended.belief
        ends.append(ended)
    record: TightEnded = stacked(ends)
    return tight_history(model, start, line, record, noise, "sequential" if in_turn else "exact", 1)
