"""Emulated outages of a full-IMU filter, and the windows that a network learns from.

From every tenth second of the filter's past it runs on without fixes, with whatever else holds it
(odometer, axle, standstill), as it does in an outage; how far that strays from what the filter
knew later is the error that an outage starting there would have had. Nothing from the end on is
looked at. The targets are metres per step along and across the coast's own azimuth: they do not
depend on where the car is or which way it goes.
"""

from typing import Final, Literal, NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import angles_from_matrix, matrix_from_quaternion
from navlearn.errors import FitError
from navlearn.filters.ins_belief import InsBelief, map_ins_belief
from navlearn.frames import enu_between, shift_geodetic
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.layout import imu_corrected, imu_errors
from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.learning.ins_regressors import coast_means, ins_regressors
from navlearn.learning.pseudo_outages import (
    PseudoOutageOptions,
    outage_starts,
    samples_since_fix,
)
from navlearn.learning.windows import Windows
from navlearn.states import FixTiming, GnssFix, ImuSample, InsState

INS_OUTPUTS: Final = ("along", "cross")
"""What the network puts out, m per step."""

Form = Literal["exact", "fast", "sequential"]


class InsOutages(NamedTuple):
    """N emulated outages of L samples.

    Attributes:
        belief: What the filter believed at their starts, batch shape (N,).
        samples: Sensor intervals through them, shape (N, L) each, vectors (N, L, 3).
        predicted: The filter without fixes, shape (N, L) each.
        reference: What the filter knew later, shape (N, L) each.
        start_time: Starts, s, shape (N,).
        block: Samples per step; L is a multiple of it.
    """

    belief: InsBelief
    samples: ImuSample
    predicted: InsState
    reference: InsState
    start_time: Tensor
    block: int


def filter_without_fixes(
    ekf: InsEkf | InsUkf, belief: InsBelief, samples: ImuSample, method: Form = "fast"
) -> InsState:
    """Return the filter's path from beliefs on with no fix, shape (N, L) each.

    Args:
        ekf: The filter.
        belief: Where to start, batch shape (N,).
        samples: Sensor intervals, shape (N, L) each.
        method: Form of the filter.
    """
    none = samples.dt[:, :0]
    with torch.no_grad():
        history = ekf(
            belief,
            samples,
            GnssFix(*(none for _ in GnssFix._fields)),
            FixTiming(none.to(torch.int64), none),
            method=method,
        )
    path: InsState = history.trajectory
    return path


def emulate_ins_outages(
    ekf: InsEkf | InsUkf,
    samples: ImuSample,
    history: InsHistory,
    options: PseudoOutageOptions,
    *,
    method: Form = "fast",
    end: int | None = None,
    begin: float = 0.0,
) -> InsOutages:
    """Run a filter on without fixes from many moments of its past.

    Args:
        ekf: What made the history.
        samples: The intervals that it went over, shape (T,) each.
        history: A run with fixes over one drive, without batch axis.
        options: Lengths and distances.
        method: Form of the filter.
        end: Only samples before this one exist; None takes all.
        begin: When the first interval begins, s.

    Raises:
        FitError: The past is too short, or the car hardly moved.
    """
    known = samples.dt.shape[-1] if end is None else end
    dt = float(samples.dt[:known].median())
    block = max(1, round(options.step / dt))
    length = round(options.horizon / options.step) * block
    starts, blocks = outage_starts(history.end, options, known, length, dt)
    rows = starts.unsqueeze(-1) + 1 + torch.arange(length)
    moved = history.trajectory.v_l[..., :2].norm(dim=-1) * samples.dt
    since = samples_since_fix(history.end, history.fix, samples.dt.shape[-1])
    kept = (moved[rows].sum(-1) >= options.minimum_distance) & (
        (since[rows] * dt).amax(-1) <= options.max_fix_interval
    )
    if not bool(kept.any()):
        raise FitError(
            f"emulated outages: none of {len(starts)} before {known * dt:.0f} s drives "
            f"{options.minimum_distance:g} m in {options.horizon:g} s with fixes at most "
            f"{options.max_fix_interval:g} s apart; start the outages later"
        )
    rows = rows[kept]
    window = ImuSample(*(channel[rows] for channel in samples))
    belief = map_ins_belief(history.belief, lambda channel: channel[blocks[kept]])
    return InsOutages(
        belief=belief,
        samples=window,
        predicted=filter_without_fixes(ekf, belief, window, method),
        reference=InsState(*(channel[rows] for channel in history.trajectory)),
        start_time=begin + (starts[kept].double() + 1.0) * dt,
        block=block,
    )


def select_ins_outages(outages: InsOutages, index: Tensor) -> InsOutages:
    """Return some of the emulated outages.

    Args:
        outages: Emulated outages.
        index: Which, int64, shape (N',), or bool, shape (N,).
    """
    return InsOutages(
        map_ins_belief(outages.belief, lambda channel: channel[index]),
        ImuSample(*(channel[index] for channel in outages.samples)),
        InsState(*(channel[index] for channel in outages.predicted)),
        InsState(*(channel[index] for channel in outages.reference)),
        outages.start_time[index],
        outages.block,
    )


def coast_azimuth(path: InsState) -> Tensor:
    """Return the azimuth of a path, rad, shape (..., L).

    Args:
        path: Solution, shape (..., L) each.
    """
    return angles_from_matrix(matrix_from_quaternion(path.q_lb))[0]


def ins_error_increments(predicted: InsState, reference: InsState, block: int) -> Tensor:
    """Return what the position error grew by in every step, along and across the coast's azimuth.

    Args:
        predicted: The coast, shape (..., L) each; L is a multiple of the block.
        reference: What it is judged by, shape (..., L) each.
        block: Samples per step.

    Returns:
        Metres, shape (..., S, 2).
    """
    at = slice(block - 1, None, block)
    here = InsState(*(c[..., at] for c in predicted[:3]), *(c[..., at, :] for c in predicted[3:]))
    there = (channel[..., at] for channel in reference[:3])
    east, north, _ = enu_between(here.lat, here.lon, here.height, *there)
    d_east, d_north = (
        torch.diff(error, dim=-1, prepend=torch.zeros_like(error[..., :1]))
        for error in (east, north)
    )
    azimuth = coast_azimuth(here)
    sin, cos = torch.sin(azimuth), torch.cos(azimuth)
    return torch.stack((d_east * sin + d_north * cos, d_east * cos - d_north * sin), -1)


def without_increments(path: InsState, increments: Tensor, block: int) -> InsState:
    """Return a path less predicted increments of its position error, spread over each step.

    Args:
        path: The coast, shape (..., L) each.
        increments: Along and across the azimuth at the end of each step, m, shape (..., S, 2),
            with S steps that cover the L samples; the last may be unfinished.
        block: Samples per step.
    """
    length = path.lat.shape[-1]
    ends = (torch.arange(length) // block * block + block - 1).clamp(max=length - 1)
    azimuth = coast_azimuth(path)[..., ends]
    each = (increments / block).repeat_interleave(block, dim=-2)[..., :length, :]
    along, cross = each.unbind(-1)
    sin, cos = torch.sin(azimuth), torch.cos(azimuth)
    east = torch.cumsum(along * sin + cross * cos, -1)
    north = torch.cumsum(along * cos - cross * sin, -1)
    level = torch.zeros_like(east)
    lat, lon, height = shift_geodetic(path.lat, path.lon, path.height, -east, -north, level)
    return path._replace(lat=lat, lon=lon, height=height)


def coast_inputs(
    ekf: InsEkf | InsUkf,
    belief: InsBelief,
    samples: ImuSample,
    path: InsState,
    names: tuple[str, ...],
    block: int,
) -> Tensor:
    """Return the regressors of coasts, step by step, shape (N, S, m).

    Args:
        ekf: What coasts.
        belief: What it believed at the starts, batch shape (N,).
        samples: Sensor intervals, shape (N, L) each; whole steps.
        path: The coasts, shape (N, L) each.
        names: Names of the regressors.
        block: Samples per step.
    """
    errors = imu_errors(ekf.model.layout, belief.sensor.unsqueeze(-2))
    omega, force = imu_corrected(errors, samples.omega_ib_b, samples.f_b)
    return ins_regressors(coast_means(path, samples.dt, omega, force, block), names)


def ins_training_windows(
    ekf: InsEkf | InsUkf, outages: InsOutages, names: tuple[str, ...]
) -> Windows:
    """Return windows of regressors and error increments, every row of weight one.

    Args:
        ekf: What emulated the outages.
        outages: Emulated outages.
        names: Names of the regressors.
    """
    u = coast_inputs(ekf, outages.belief, outages.samples, outages.predicted, names, outages.block)
    y = ins_error_increments(outages.predicted, outages.reference, outages.block)
    return Windows(u, y, torch.ones_like(y[..., 0]), outages.start_time)
