"""With what the RISS filter starts after an alignment, and which measurements come after it."""

from typing import TypeVar

from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.options import EkfOptions
from navlearn.mechanization.alignment import Alignment
from navlearn.states import FixTiming, GnssFix, SatelliteRanges

Told = TypeVar("Told", GnssFix, SatelliteRanges)


def aligned_belief(options: EkfOptions, alignment: Alignment) -> Belief:
    """Return the belief that an alignment justifies.

    Args:
        options: Choices of the filter.
        alignment: Where and with what the filter starts.

    Returns:
        Belief, no batch axis.
    """
    return initial_belief(
        options,
        alignment.state,
        sensor={"gyro_bias": alignment.gyro_bias},
        sigmas={
            "east": alignment.position_sigma,
            "north": alignment.position_sigma,
            "up": alignment.height_sigma,
            "azimuth": alignment.azimuth_sigma,
            "gyro_bias": alignment.gyro_bias_sigma,
        },
    )


def told_from(told: Told, timing: FixTiming, first: int) -> tuple[Told, FixTiming]:
    """Return what is used at the end of an interval or later.

    Args:
        told: Fixes, shape (M,) each, or receptions of ranges, shape (M, S) each.
        timing: Where they fall, shape (M,) each.
        first: The interval.

    Returns:
        Fixes or receptions, and timing whose indices count from that interval.
    """
    later = timing.index >= first

    def cut(channel: Tensor) -> Tensor:
        return channel[later]

    kept = type(told)(
        *(
            channel if name == "system" else cut(channel)
            for name, channel in zip(told._fields, told, strict=True)
        )
    )
    return kept, FixTiming(cut(timing.index) - first, cut(timing.delay))
