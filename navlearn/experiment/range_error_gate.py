"""The gate of range-error models: would they have helped in the last partial outages?

Each emulated outage starts from what the filter believed then, with the satellites that stay now
and no others, once on ranges as they are and once on ranges less what the model, fitted to what
came before, says. Both are compared with what the filter knew with all satellites. That reference
shares its own error with the start of both, which the margin has to allow for.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FitError
from navlearn.experiment.range_error_correction import corrected
from navlearn.experiment.range_error_replays import (
    HeardBefore,
    Replays,
    heard_before,
    one_of,
    recent_replays,
    rms_error,
    run_replays,
)
from navlearn.experiment.tight_filter_runs import TightStart, receptions
from navlearn.learning.range_record import RangeRecord, range_record
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.states import FixTiming


class Past(NamedTuple):
    """What came before an outage.

    Attributes:
        heard: The receptions that the filter was given.
        record: What it made of them.
    """

    heard: HeardBefore
    record: RangeRecord


def past_of(start: TightStart) -> Past:
    """Return what came before an outage.

    Args:
        start: The run up to the outage's start.
    """
    early = torch.arange(len(start.series.t)) < len(start.series.t) - len(start.received)
    heard = heard_before(
        start.run,
        receptions(start.series.ranges, early),
        FixTiming(*(channel[early] for channel in start.series.timing)),
        start.series.t[early],
    )
    return Past(heard, range_record(start.run.history, heard.ranges, heard.t))


def judged(start: TightStart, past: Past, visible: Tensor, spec: RangeErrorSpec) -> GateVerdict:
    """Return whether a model may act.

    Args:
        start: The run up to the outage's start.
        past: What came before it.
        visible: Satellites that stay, bool, shape (S,).
        spec: The model.
    """
    guard = spec.safeguard
    if not guard.gate:
        return GateVerdict(use=True, improvement=math.nan, replays=0, margin=guard.gate_margin)
    replays = recent_replays(start.run, past.heard, visible, spec)
    errors = torch.zeros(2, 0, dtype=torch.float64)
    if replays is not None:
        errors = replayed(start, past, replays, visible, spec)
    return rolling_origin_gate(*errors, margin=guard.gate_margin, fewest=guard.gate_fewest)


def replayed(
    start: TightStart, past: Past, replays: Replays, visible: Tensor, spec: RangeErrorSpec
) -> Tensor:
    """Return the error of emulated outages with a model and without.

    Args:
        start: The run up to the outage's start.
        past: What came before it.
        replays: The emulated outages.
        visible: Satellites that stay, bool, shape (S,).
        spec: The model; it is fitted anew before each of them.

    Returns:
        RMS horizontal errors with and without the model, m, shape (2, N); outages before which
        nothing could be fitted are left out.
    """
    noise = start.navigator.options.tight.range_noise
    plain = run_replays(start.navigator, start.run, replays, replays.ranges)
    pseudorange, std = replays.ranges.pseudorange.clone(), replays.ranges.std_range.clone()
    kept = []
    for k, block in enumerate(replays.block.tolist()):
        count = int((past.record.reception <= start.run.history.reception[block]).sum())
        before = RangeRecord(*(channel[:count] for channel in past.record))
        t = past.heard.t[replays.reception[k].clamp(min=0)]
        ranges = one_of(replays.ranges, k)
        after = range_record(one_of(plain, k), ranges, t)
        try:
            found = corrected(before, after, float(t[0]), ranges, visible, spec, noise)
        except FitError:
            continue
        pseudorange[k], std[k] = found.ranges.pseudorange, found.ranges.std_range
        kept.append(k)
    less = replays.ranges._replace(pseudorange=pseudorange, std_range=std)
    better = run_replays(start.navigator, start.run, replays, less)
    errors = [rms_error(one.trajectory, replays.reference) for one in (better, plain)]
    return torch.stack(errors)[:, kept]
