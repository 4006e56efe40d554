"""What a range-error model says of an outage, taken off the ranges of the satellites that stay."""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError
from navlearn.gnss.range_noise import RangeNoiseOptions, range_noise, range_variance
from navlearn.learning.range_error_model import RangeErrors, predict_range_errors, range_source
from navlearn.learning.range_record import RangeRecord, joined
from navlearn.learning.range_residuals import residual_series
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.states import SatelliteRanges

FARTHEST = 1e6
"""Largest correction, m: a model that runs away makes a wild range, which is the gate's to refuse,
and no range in other units, at which a filter stops."""


class Corrected(NamedTuple):
    """Ranges of an outage less what a model says of their errors.

    Attributes:
        ranges: Receptions, shape (M, S) each; the deviations that they tell are wider where the
            spec says so.
        correction: What was taken off, m, shape (M, S).
        errors: The model's prediction.
    """

    ranges: SatelliteRanges
    correction: Tensor
    errors: RangeErrors


def corrected(
    before: RangeRecord,
    after: RangeRecord,
    start: float,
    ranges: SatelliteRanges,
    visible: Tensor,
    spec: RangeErrorSpec,
    noise: RangeNoiseOptions,
    logs: tuple[str, ...] = (),
) -> Corrected:
    """Fit to what came before a partial outage and take its prediction off the ranges in it.

    Args:
        before: What the filter made of the receptions before the outage.
        after: What it made of those in it, uncorrected: inputs alone are read.
        start: The outage's start, s.
        ranges: The receptions in the outage that ``after`` tells of, shape (M, S) each.
        visible: Satellites that stay, bool, shape (S,).
        spec: The model.
        noise: What the filter believes of ranges.
        logs: Names of the logs, for the record.

    Raises:
        FitError: Nothing can be learned, or nothing was received.
    """
    if len(after.t) == 0:
        raise FitError("no reception falls into the outage, so there is no range to correct")
    options = spec.range_error_options()
    series = residual_series(joined(before, after), start, options.residual_options())
    source = range_source(options, series.step, logs)
    errors = predict_range_errors(series, visible, options, source)
    rows = series.row[len(before.t) :] - series.origin
    correction = torch.zeros_like(ranges.pseudorange)
    # where receptions come faster than samples one before the start may be among them
    inside = after.t >= start
    correction[after.reception[inside]] = errors.error[rows[inside]].clamp(-FARTHEST, FARTHEST)
    less = ranges._replace(pseudorange=ranges.pseudorange - correction)
    if spec.wider_m > 0.0:
        wider = told_wider(ranges, noise, spec.wider_m)
        less = less._replace(std_range=torch.where(errors.known, wider, ranges.std_range))
    return Corrected(less, correction, errors)


def told_wider(ranges: SatelliteRanges, noise: RangeNoiseOptions, further: float) -> Tensor:
    """Return the deviations by which a receiver would tell that ranges err by so much more.

    Args:
        ranges: Receptions, shape (M, S) each; where no deviation is told the filter goes by C/N0.
        noise: What the filter believes of ranges.
        further: Deviation of what is added, m.

    Returns:
        m, shape (M, S).

    Raises:
        ConfigError: The filter is told to ignore deviations.
    """
    if noise.told_factor == 0.0:
        raise ConfigError(
            "tight.range_noise.told_factor: found 0, with which a filter ignores deviations; "
            "wider_m needs a positive factor"
        )
    tracking = replace(noise, orbit_clock=0.0, ionosphere=0.0, troposphere=0.0, multipath=0.0)
    own = range_variance(range_noise(tracking), ranges.elevation, ranges.cn0, ranges.std_range)
    return torch.sqrt(own + further**2) / noise.told_factor
