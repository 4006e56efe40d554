"""What is refused at the tight filter's door, and what is said about a run that went wrong."""

import warnings
from typing import Any

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.filters.tight_belief import TightBelief
from navlearn.fusion.bounds import check_bounds
from navlearn.fusion.checks import (
    check_beliefs,
    check_channels,
    check_covariance,
    check_shapes,
)
from navlearn.fusion.measurements import Verdict, refused
from navlearn.fusion.run_warnings import WARN_AT_LEAST, WARN_REFUSED, warn_of_refusals
from navlearn.fusion.tight.bounds import check_ranges
from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.model import TightModel
from navlearn.fusion.tight.vehicle import no_fixes
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample, SatelliteRanges


def check_tight_inputs(
    model: TightModel,
    start: TightBelief[Any],
    samples: RissSample | ImuSample,
    ranges: SatelliteRanges,
    timing: FixTiming,
    fixes: GnssFix | None,
) -> None:
    """Refuse what a filter cannot run on.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        samples: Samples, batch shape (B, T).
        ranges: Ranges, shape (B, M, S) each.
        timing: Where the receptions fall, shape (B, M) each.
        fixes: Fixes at the same moments, shape (B, M) each, or None.

    Raises:
        ShapeError: If a tensor has the wrong shape or type.
        LogError: If samples, ranges or fixes are not finite where they are used, hold what no
            drive can (:mod:`navlearn.fusion.tight.bounds`), or are out of order or range.
        FilterDivergedError: If the start's covariance is not finite and positive.
    """
    given = no_fixes(timing) if fixes is None else fixes
    _check_shapes(model, start, samples, ranges, timing, given)
    check_channels(samples, given, timing)
    state = start.vehicle.state
    check_bounds(samples, given, timing, (state.lat, state.lon))
    check_ranges(ranges, timing, model.systems)
    check_covariance(start.covariance)


def _check_shapes(
    model: TightModel,
    start: TightBelief[Any],
    samples: RissSample | ImuSample,
    ranges: SatelliteRanges,
    timing: FixTiming,
    fixes: GnssFix,
) -> None:
    batch, size, receptions = samples.dt.shape[0], model.size, tuple(timing.index.shape)
    if ranges.has_range.dim() != 3 or ranges.has_range.shape[-1] == 0:
        raise ShapeError(
            f"tight filter: ranges.has_range has shape {tuple(ranges.has_range.shape)}; expected "
            "(B, M, S) or (M, S) with at least one satellite: give one that is never measured"
        )
    count = ranges.has_range.shape[-1]
    if timing.index.dtype != torch.int64 or ranges.system.dtype != torch.int64:
        raise ShapeError(
            f"tight filter: timing.index is {timing.index.dtype}, ranges.system "
            f"{ranges.system.dtype}; expected int64: use .long()"
        )
    expected: list[tuple[str, Tensor, tuple[int, ...]]] = [
        ("start.covariance", start.covariance, (batch, size, size)),
        ("start.clock", start.clock, (batch, size - model.first_clock)),
        ("start.refused", start.refused, (batch, 2 * count + 2)),
        ("timing.delay", timing.delay, receptions),
        ("samples.dt", samples.dt, (batch, samples.dt.shape[-1])),
    ]
    for name, channel in ranges._asdict().items():
        axes = (3,) if name in ("satellite", "satellite_velocity") else ()
        if name != "system":
            expected.append((f"ranges.{name}", channel, (*receptions, count, *axes)))
    expected += [
        (f"fixes.{name}", channel, receptions) for name, channel in fixes._asdict().items()
    ]
    check_shapes(
        expected,
        f"{batch} drives, {count} satellites of {model.systems} systems, and error states "
        f"{', '.join(model.names)}",
    )


def check_tight_history(
    model: TightModel, history: TightHistory, samples: RissSample | ImuSample
) -> None:
    """Refuse a run that lost its covariance or its state; warn of one that refuses most.

    Args:
        model: The filter.
        history: Its run, batch shape (B, K).
        samples: What it ran on, batch shape (B, T).

    Raises:
        FilterDivergedError: If a state or variance is not finite, or a variance not positive.
    """
    belief = history.belief
    whole = belief.vehicle._replace(covariance=belief.covariance)
    check_beliefs(model.names, whole, history.end, samples.dt)
    warn_of_refusals(model.vehicle, history.own_verdict)
    count = history.innovation.shape[-1]
    for name, verdict in (
        ("pseudoranges", history.verdict[..., :count]),
        ("range rates", history.verdict[..., count:]),
    ):
        seen = int((verdict != int(Verdict.ABSENT)).sum())
        out = int(refused(verdict).sum())
        if seen >= WARN_AT_LEAST and out > WARN_REFUSED * seen:
            warnings.warn(
                f"tight filter: the gate refused more than {WARN_REFUSED:.0%} of the {name}; the "
                "range noise is too small for this log, or corrections, clock or start are wrong: "
                "look at history.innovation and history.nis",
                UserWarning,
                stacklevel=3,
            )
