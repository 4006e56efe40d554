"""A batch of drives laid out in blocks that end where ranges are received."""

from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.fusion.blocks import Blocks, gathered
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.options import TightEkfOptions
from navlearn.fusion.tight.vehicle import VehicleLine
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges

Fields = TypeVar("Fields", GnssFix, SatelliteRanges)

FAR = 2.6e7
"""Where a satellite is put that is not measured, m from the Earth's centre."""


class Reception(NamedTuple):
    """What was received at the end of blocks, batch shape (...).

    Attributes:
        ranges: Ranges; none may be used where a block ends without a reception.
        delay: End of the block minus the time of reception, s, shape (...).
        elapsed: Length of the block, s, shape (...).
        since: Time since the reception before, s, shape (...).
    """

    ranges: SatelliteRanges
    delay: Tensor
    elapsed: Tensor
    since: Tensor


class TightLine(NamedTuple):
    """Drives in blocks.

    Attributes:
        vehicle: The vehicle's side of them.
        reception: What was received at the end of each block, batch shape (B, K).
    """

    vehicle: VehicleLine
    reception: Reception


def tight_timeline(
    model: TightModel,
    samples: RissSample | ImuSample,
    ranges: SatelliteRanges,
    timing: FixTiming,
    fixes: GnssFix | None,
    silence: Tensor | None = None,
) -> TightLine:
    """Return drives laid out in blocks.

    Args:
        model: The filter.
        samples: Samples, batch shape (B, T).
        ranges: Ranges, shape (B, M, S) each; M may be 0.
        timing: Where the receptions fall, shape (B, M) each.
        fixes: Fixes at the same moments, shape (B, M) each, or None.
        silence: Time from the last reception before the first sample to its beginning, s, shape
            (B,) or (); None where there was none.

    Returns:
        Timeline.
    """
    line = model.vehicle.laid_out(samples, fixes, timing)
    blocks = line.blocks
    elapsed = (gathered(samples.dt, blocks.gather) * blocks.used).sum(-1)
    received = ranges_at_ends(blocks, usable(model.options, ranges))
    since = _since_reception(elapsed, blocks.fix >= 0, silence)
    return TightLine(line, Reception(received, line.delay, elapsed, since))


@torch.no_grad()
def _since_reception(elapsed: Tensor, received: Tensor, silence: Tensor | None) -> Tensor:
    """Return how long before the end of each block the reception before it was, s, shape (B, K).

    Infinite before the first one of all.
    """
    first = torch.full_like(elapsed[:, :1], torch.inf)
    if silence is not None:
        first = silence.reshape(-1, 1).expand_as(first)
    end = torch.cumsum(elapsed, 1)
    latest = torch.cummax(torch.where(received, end, -torch.inf), 1).values
    before = torch.nn.functional.pad(latest[:, :-1], (1, 0), value=-torch.inf)
    return end - torch.maximum(before, -first)


def with_system_each(ranges: SatelliteRanges) -> SatelliteRanges:
    """Return ranges whose systems are told at every reception.

    Args:
        ranges: Ranges, shape (B, M, S) each; systems of that shape or of shape (B, S).
    """
    if ranges.system.dim() == ranges.has_range.dim():
        return ranges
    each = ranges.system.unsqueeze(-2).expand(ranges.has_range.shape)
    return ranges._replace(system=each)


def usable(options: TightEkfOptions, ranges: SatelliteRanges) -> SatelliteRanges:
    """Return ranges with everything that is not used put to harmless values.

    What was not measured may be NaN or anything; neither it nor its gradient gets any further.

    Args:
        options: Tells which satellites stand high enough and are received well enough.
        ranges: Ranges, shape (..., S) each.

    Returns:
        Ranges.
    """
    high = (ranges.elevation >= options.elevation_mask) & (ranges.cn0 >= options.least_cn0)
    has_range = (ranges.has_range > 0.5) & high
    has_rate = (ranges.has_rate > 0.5) & high & options.use_rates
    there = has_range | has_rate
    far = ranges.satellite.new_tensor([FAR, 0.0, 0.0])

    def kept(value: Tensor, use: Tensor, instead: float) -> Tensor:
        return torch.where(use, value, instead)

    return SatelliteRanges(
        torch.where(there.unsqueeze(-1), ranges.satellite, far),
        torch.where(has_rate.unsqueeze(-1), ranges.satellite_velocity, 0.0),
        kept(ranges.pseudorange, has_range, 0.0),
        kept(ranges.range_rate, has_rate, 0.0),
        kept(ranges.elevation, there, 1.0),
        kept(ranges.cn0, there, 45.0),
        kept(ranges.std_range, has_range, 0.0),
        kept(ranges.std_rate, has_rate, 0.0),
        torch.where(there, ranges.system, 0),
        has_range.to(ranges.has_range),
        has_rate.to(ranges.has_rate),
    )


def ranges_at_ends(blocks: Blocks, ranges: SatelliteRanges) -> SatelliteRanges:
    """Return what is received at the end of each block.

    Args:
        blocks: Blocks; ``fix`` counts receptions.
        ranges: Ranges without NaN, shape (B, M, S) each.

    Returns:
        Ranges, none to be used where a block ends without a reception, shape (B, K, S) each.
    """
    if ranges.has_range.shape[1] == 0:
        ranges = SatelliteRanges(*(_one_empty(channel) for channel in ranges))
        ranges = ranges._replace(satellite=ranges.satellite + FAR)
    chosen = blocks.fix.clamp(min=0)
    there = (blocks.fix >= 0).unsqueeze(-1).to(ranges.has_range)

    def at(channel: Tensor) -> Tensor:
        return gathered(channel.flatten(2), chosen).reshape(*chosen.shape, *channel.shape[2:])

    found = SatelliteRanges(*map(at, ranges))
    return found._replace(has_range=found.has_range * there, has_rate=found.has_rate * there)


def _one_empty(channel: Tensor) -> Tensor:
    return channel.new_zeros((channel.shape[0], 1, *channel.shape[2:]))
