"""Few places instead of many slots: a satellite has a slot for the whole drive, but most are empty.

What an update costs grows with the square and the cube of its rows. Of all satellites of a drive
only those that are received take a place, as many as the richest reception has.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.tight.timeline import Reception
from navlearn.states import SatelliteRanges


class Places(NamedTuple):
    """Which satellite stands at which place.

    Attributes:
        slot: Slot of each of P places, each at most once, int64, shape (..., P).
        slots: Number S of slots.
    """

    slot: Tensor
    slots: int

    def packed(self, values: Tensor) -> Tensor:
        """Return values of slots at places.

        Args:
            values: Pseudoranges, or these and range rates, shape (..., S) or (..., 2 S).

        Returns:
            Shape (..., P) or (..., 2 P).
        """
        halves = _rows(values, self.slots)
        index = self.slot.unsqueeze(-2).expand(*halves.shape[:-1], self.slot.shape[-1])
        return torch.gather(halves, -1, index).flatten(-2)

    def spread(self, values: Tensor, empty: float | Tensor) -> Tensor:
        """Return values of places at slots.

        Args:
            values: Shape (..., P) or (..., 2 P).
            empty: What stands at slots without a place: one value, or values of all slots.

        Returns:
            Shape (..., S) or (..., 2 S).
        """
        halves = _rows(values, self.slot.shape[-1])
        wide = (*halves.shape[:-1], self.slots)
        if isinstance(empty, Tensor):
            base = _rows(empty, self.slots).expand(wide)
        else:
            base = halves.new_full(wide, empty)
        index = self.slot.unsqueeze(-2).expand(halves.shape)
        return torch.scatter(base, -1, index, halves).flatten(-2)

    def packed_counts(self, refused: Tensor) -> Tensor:
        """Return refusals of slots at places, those of all ranges and all rates behind them.

        Args:
            refused: As in ``TightBelief``, shape (..., 2 S + 2).

        Returns:
            Shape (..., 2 P + 2).
        """
        return torch.cat((self.packed(refused[..., :-2]), refused[..., -2:]), -1)

    def spread_counts(self, refused: Tensor, before: Tensor) -> Tensor:
        """Return refusals of places at slots; what has no place keeps its count.

        Args:
            refused: Shape (..., 2 P + 2).
            before: Refusals of slots before, shape (..., 2 S + 2).

        Returns:
            Shape (..., 2 S + 2).
        """
        return torch.cat((self.spread(refused[..., :-2], before[..., :-2]), refused[..., -2:]), -1)


def _rows(values: Tensor, length: int) -> Tensor:
    return values.reshape(*values.shape[:-1], values.shape[-1] // length, length)


def packed_reception(reception: Reception) -> tuple[Reception, Places]:
    """Return receptions of the satellites that are received, and where these stand.

    Args:
        reception: Receptions, shape (..., S).

    Returns:
        Receptions, shape (..., P); where fewer are received, places stay empty.
    """
    ranges = reception.ranges
    heard = (ranges.has_range > 0.5) | (ranges.has_rate > 0.5)
    slots = heard.shape[-1]
    count = max(1, int(heard.sum(-1).amax())) if heard.numel() else slots
    order = torch.argsort((~heard).to(torch.int8), dim=-1, stable=True)
    places = Places(order[..., :count], slots)

    def at(channel: Tensor) -> Tensor:
        if channel.dim() == heard.dim():
            return torch.gather(channel, -1, places.slot)
        index = places.slot.unsqueeze(-1).expand(*places.slot.shape, channel.shape[-1])
        return torch.gather(channel, -2, index)

    return reception._replace(ranges=SatelliteRanges(*map(at, ranges))), places
