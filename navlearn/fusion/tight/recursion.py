"""The tightly coupled filter as a loop over blocks: predict one, update at its end, go on."""

from typing import Any

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.recursion import stacked, unstacked
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.packing import Places, packed_reception
from navlearn.fusion.tight.prediction import predicted_belief
from navlearn.fusion.tight.record import tight_history
from navlearn.fusion.tight.steps import LINEAR, TightSteps
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
    steps: TightSteps = LINEAR,
) -> TightHistory:
    """Run the filter block after block.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise of ranges and clock.
        in_turn: Whether a block's samples are taken one after another, not at once.
        steps: How the filter predicts and sees.

    Returns:
        History.
    """
    belief, ends = start, list[TightEnded]()
    heard, places = packed_reception(line.reception)
    blocks = blocks_in_turn(model.vehicle, line.vehicle)
    stops = zip(blocks, unstacked(heard), places.slot.unbind(1), strict=True)
    for block, reception, slot in stops:
        ahead = steps.ahead(model, belief, block, reception.elapsed, noise, in_turn=in_turn)
        prior = predicted_belief(ahead, belief.covariance)
        here = Places(slot, places.slots)
        ended = updated(model, prior, block, reception, here, noise, steps.see)
        belief = ended.belief
        ends.append(ended)
    record: TightEnded = stacked(ends)
    method = "sequential" if in_turn else "exact"
    return tight_history(model, start, line, (heard, places), record, noise, method, 1)
