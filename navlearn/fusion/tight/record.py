"""From the ends of blocks to a history of the tightly coupled filter."""

from typing import Any

import torch

from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.noise import TightNoise
from navlearn.fusion.tight.packing import Places
from navlearn.fusion.tight.ranges import measured_ranges
from navlearn.fusion.tight.timeline import Reception, TightLine
from navlearn.fusion.tight.update import TightEnded


def tight_history(
    model: TightModel,
    start: TightBelief[Any],
    line: TightLine,
    packed: tuple[Reception, Places],
    record: TightEnded,
    noise: TightNoise,
    method: str,
    passes: int,
) -> TightHistory:
    """Return the history of a run.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        packed: Receptions at places, and which satellite stands where, batch shape (B, K).
        record: Every block's end, batch shape (B, K), satellites at places.
        noise: Noise of ranges.
        method: Form that computed it.
        passes: Passes it took.

    Returns:
        History.
    """
    vehicle, after = model.vehicle, record.belief
    reception, places = packed
    antenna = vehicle.antenna(after.vehicle, vehicle.all_blocks(line.vehicle), reception.delay)
    left = measured_ranges(antenna, after.clock, reception, noise)
    residual = torch.where(left.present > 0.5, left.innovation, torch.nan)
    record, residual = _at_slots(places, record), places.spread(residual, torch.nan)
    count, blocks = places.slots, line.vehicle.blocks
    return TightHistory(
        blocks.end,
        blocks.fix,
        record.prior,
        after,
        vehicle.path(start.vehicle, after.vehicle, line.vehicle),
        record.innovation[..., :count],
        record.innovation[..., count:],
        residual[..., :count],
        record.spread[..., :count],
        record.judged.nis,
        record.judged.verdict,
        record.own_innovation,
        record.own.nis,
        record.own.verdict,
        record.judged.reset.sum(1),
        method,
        passes,
    )


def _at_slots(places: Places, record: TightEnded) -> TightEnded:
    """Return a record whose satellites stand at their slots again."""
    judged = record.judged
    return record._replace(
        innovation=places.spread(record.innovation, torch.nan),
        spread=places.spread(record.spread, torch.nan),
        judged=judged._replace(
            nis=places.spread(judged.nis, torch.nan),
            verdict=places.spread(judged.verdict, int(Verdict.ABSENT)),
        ),
    )
