"""What is refused at the filter's door, and a run that lost its covariance or its state."""

from enum import IntEnum

import torch
from torch import Tensor

from navlearn.errors import FilterDivergedError, LogError, ShapeError
from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.bounds import check_bounds
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measurements import Kind
from navlearn.fusion.run_warnings import warn_of_noise, warn_of_refusals
from navlearn.states import FixTiming, GnssFix, ImuSample, RissSample

NOISE_BEHIND: dict[IntEnum, str] = {
    Kind.POSITION: "position_inflation, position_floor or height_floor",
    Kind.VELOCITY: "velocity_inflation, velocity_floor or speed_noise",
    Kind.COURSE: "velocity_inflation or velocity_floor",
    Kind.ZERO_YAW_RATE: "zero_yaw_rate",
    Kind.ZERO_SPEED: "zero_speed",
}
"""Noise to change where the NIS of a kind is far off."""


def check_inputs(
    model: FilterModel, start: Belief, samples: RissSample, fixes: GnssFix, timing: FixTiming
) -> None:
    """Refuse what a filter cannot run on.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        samples: Samples, shape (B, T) each.
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Raises:
        ShapeError: If a tensor has the wrong shape or type.
        LogError: If samples or valid fixes are not finite or hold what no drive can
            (:func:`navlearn.fusion.bounds.check_bounds`), or fixes are out of order or range.
        FilterDivergedError: If the start's covariance is not finite and positive.
    """
    _check_shapes(model, start, samples, fixes, timing)
    check_channels(samples, fixes, timing)
    check_bounds(samples, fixes, timing, (start.state.lat, start.state.lon))
    check_covariance(start.covariance)


def check_channels(samples: RissSample | ImuSample, fixes: GnssFix, timing: FixTiming) -> None:
    """Refuse samples and fixes that are not finite, and fixes out of order or range.

    Args:
        samples: Samples, shape (B, T) each, vectors (B, T, 3).
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Raises:
        LogError: If that is so.
    """
    for name, channel in zip(samples._fields, samples, strict=True):
        bad = ~torch.isfinite(channel)
        if bool(bad.any()):
            at = bad.nonzero()[0].tolist()
            raise LogError(
                f"filter: samples.{name} of drive {at[0]} is {float(channel[tuple(at)])} at sample "
                f"{at[1]}; expected finite values: fill or cut the gap before filtering"
            )
    for name, channel in zip(fixes._fields, fixes, strict=True):
        bad = ~torch.isfinite(channel)
        if bool(bad.any()):
            row, k = bad.nonzero()[0].tolist()
            raise LogError(
                f"filter: fixes.{name} of drive {row} is {float(channel[row, k])} at fix {k}; "
                "what is not valid must hold a finite value and has_position or has_velocity 0"
            )
    index = timing.index
    used = torch.where(index < 0, -1, index)
    latest = torch.cummax(used, 1).values
    wrong = (index >= samples.dt.shape[1]) | ((index >= 0) & (index < latest))
    if bool(wrong.any()):
        row, k = wrong.nonzero()[0].tolist()
        raise LogError(
            f"filter: timing.index of drive {row} is {int(index[row, k])} at fix {k}, after "
            f"{int(latest[row, max(k - 1, 0)])}; expected sample numbers below "
            f"{samples.dt.shape[1]} that do not decrease: sort the fixes by time"
        )


def check_covariance(covariance: Tensor) -> None:
    """Refuse a covariance to start with whose variances are not finite and positive.

    Args:
        covariance: Shape (B, n, n).

    Raises:
        FilterDivergedError: If that is so.
    """
    variance = covariance.detach().diagonal(dim1=-2, dim2=-1)
    if not bool((torch.isfinite(variance) & (variance > 0.0)).all()):
        raise FilterDivergedError(
            f"filter: the start's variances are {variance.tolist()}; expected finite values above "
            "0 for every error state: give each a standard deviation"
        )


def _check_shapes(
    model: FilterModel, start: Belief, samples: RissSample, fixes: GnssFix, timing: FixTiming
) -> None:
    batch, n, m = samples.dt.shape[0], model.layout.size, len(model.layout.sensors)
    expected: list[tuple[str, Tensor, tuple[int, ...]]] = [
        ("start.covariance", start.covariance, (batch, n, n)),
        ("start.sensor", start.sensor, (batch, m)),
        ("start.anchor", start.anchor, (batch, m)),
        ("start.velocity_offset", start.velocity_offset, (batch, 3)),
        ("start.refused", start.refused, (batch, len(Kind))),
        ("timing.delay", timing.delay, tuple(timing.index.shape)),
    ]
    expected += [(f"start.state.{k}", x, (batch,)) for k, x in start.state._asdict().items()]
    expected += [(f"samples.{k}", x, tuple(samples.dt.shape)) for k, x in samples._asdict().items()]
    expected += [(f"fixes.{k}", x, tuple(timing.index.shape)) for k, x in fixes._asdict().items()]
    check_shapes(expected, f"{batch} drives and error states {', '.join(model.layout.names)}")


def check_shapes(expected: list[tuple[str, Tensor, tuple[int, ...]]], what: str) -> None:
    """Refuse tensors of wrong shape or type.

    Args:
        expected: Name, tensor and expected shape of each.
        what: What the shapes are for, for the message.

    Raises:
        ShapeError: If a tensor has the wrong shape or is not float64.
    """
    for name, tensor, shape in expected:
        if tuple(tensor.shape) != shape:
            raise ShapeError(
                f"filter: {name} has shape {tuple(tensor.shape)}; expected {shape} for {what}"
            )
        if tensor.dtype != torch.float64:
            raise ShapeError(f"filter: {name} is {tensor.dtype}; expected float64: use .double()")


def check_history(model: FilterModel, history: FilterHistory, samples: RissSample) -> None:
    """Refuse a run that lost its covariance or its state; warn of one whose noise is far off.

    Args:
        model: The filter.
        history: Its run, batch shape (B, K).
        samples: What it ran on, shape (B, T) each.

    Raises:
        FilterDivergedError: If a state or variance is not finite, or a variance not positive.
    """
    check_beliefs(model.layout.names, history.belief, history.end, samples.dt)
    warn_of_refusals(model, history.verdict)
    warn_of_noise(model, history.nis, NOISE_BEHIND, "NoiseOptions")


def check_beliefs(
    names: tuple[str, ...], belief: Belief | InsBelief, end: Tensor, dt: Tensor
) -> None:
    """Refuse a run that lost its covariance or its state.

    Args:
        names: Names of the error states.
        belief: Beliefs at the ends of blocks, batch shape (B, K).
        end: Last sample of each block, int64, shape (B, K).
        dt: Lengths of the intervals, s, shape (B, T).

    Raises:
        FilterDivergedError: If a state or variance is not finite, or a variance not positive.
    """
    variance = belief.covariance.detach().diagonal(dim1=-2, dim2=-1)
    fine = (torch.isfinite(variance) & (variance > 0.0)).all(-1)
    for value in belief.state:
        fine = fine & torch.isfinite(value.detach()).reshape(*fine.shape, -1).all(-1)
    if not bool(fine.all()):
        row, k = (~fine).nonzero()[0].tolist()
        time = float(dt[row, : int(end[row, k]) + 1].sum())
        wrong = [
            name
            for name, v in zip(names, variance[row, k].tolist(), strict=True)
            if not 0.0 < v < float("inf")
        ]
        raise FilterDivergedError(
            f"filter: drive {row} lost its estimate {time:.2f} s after its start (variances not "
            f"positive: {', '.join(wrong) or 'none; the state is not finite'}); check the noise "
            "densities, the units of samples and fixes, and the starting belief"
        )
