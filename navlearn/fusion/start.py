"""With what the RISS filter starts after an alignment, and which measurements come after it."""

import warnings
from typing import TypeVar

from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.fusion.error_state import initial_belief
from navlearn.fusion.options import EkfOptions
from navlearn.mechanization.alignment import Alignment
from navlearn.states import FixTiming, GnssFix, RissSample, SatelliteRanges

SHORT = 60.0
"""A shorter stretch of samples may well be level, s."""

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


def warn_of_level_samples(options: EkfOptions, samples: RissSample) -> None:
    """Warn where a filter that climbs is given samples that know of no hills.

    Args:
        options: Choices of the filter.
        samples: Intervals of one drive, shape (T,) each.

    Warns:
        UserWarning: The mechanization has three dimensions, and no sample of a minute and more has
            pitch or roll: the filter would be far too sure of its height.
    """
    if not options.mechanization.three_d or float(samples.dt.sum()) < SHORT:
        return
    if bool((samples.pitch != 0.0).any()) or bool((samples.roll != 0.0).any()):
        return
    warnings.warn(
        "filter: its mechanization has dimensions=3, but no sample has pitch or roll, so that it "
        "takes every road for level; give riss_timeline(log, dims=3), or take "
        "EkfOptions(mechanization=RissOptions(dimensions=2))",
        stacklevel=3,
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
