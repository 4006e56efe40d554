"""What is refused at the full-IMU filter's door, and what is said about a run that went wrong."""

from enum import IntEnum

from torch import Tensor

from navlearn.errors import LogError
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.bounds import check_bounds
from navlearn.fusion.checks import (
    check_beliefs,
    check_channels,
    check_covariance,
    check_shapes,
)
from navlearn.fusion.ins.history import InsHistory
from navlearn.fusion.ins.measurements import InsKind
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.run_warnings import warn_of_noise, warn_of_refusals
from navlearn.states import FixTiming, GnssFix, ImuSample

FASTEST_TURN = 6.0
"""Angular rate that a hundredth of the samples of a car may exceed, rad/s; degrees exceed it."""

LIGHTEST, HEAVIEST = 8.0, 12.0
"""Bounds of the root mean square specific force of a drive, m/s²: gravity and little else."""

NOISE_BEHIND: dict[IntEnum, str] = {
    InsKind.POSITION: "position_inflation, position_floor or height_floor",
    InsKind.VELOCITY: "velocity_inflation or velocity_floor",
    InsKind.ODOMETER: "odometer_noise",
    InsKind.NONHOLONOMIC: "nonholonomic_noise",
    InsKind.ZERO_VELOCITY: "zero_velocity",
    InsKind.ZERO_YAW_RATE: "zero_angular_rate",
}
"""Noise to change where the NIS of a kind is far off."""


def check_ins_inputs(
    model: InsFilterModel, start: InsBelief, samples: ImuSample, fixes: GnssFix, timing: FixTiming
) -> None:
    """Refuse what a full-IMU filter cannot run on.

    Args:
        model: The filter.
        start: Belief before the first sample, batch shape (B,).
        samples: Samples, shape (B, T) each, vectors (B, T, 3).
        fixes: Fixes, shape (B, M) each.
        timing: Where they fall, shape (B, M) each.

    Raises:
        ShapeError: If a tensor has the wrong shape or type.
        LogError: If samples or valid fixes are not finite, not in SI units or hold what no drive
            can (:func:`navlearn.fusion.bounds.check_bounds`), or fixes are out of order or range.
        FilterDivergedError: If the start's covariance is not finite and positive.
    """
    layout = model.layout
    batch, n, along = samples.dt.shape[0], layout.size, tuple(samples.dt.shape)
    vectors = ("omega_ib_b", "f_b", "v_l")
    expected: list[tuple[str, Tensor, tuple[int, ...]]] = [
        ("start.covariance", start.covariance, (batch, n, n)),
        ("start.sensor", start.sensor, (batch, n - 9)),
        ("start.refused", start.refused, (batch, len(InsKind))),
        ("timing.delay", timing.delay, tuple(timing.index.shape)),
    ]
    for name, channel in start.state._asdict().items():
        axes = (3,) if name in vectors else (4,) if name == "q_lb" else ()
        expected.append((f"start.state.{name}", channel, (batch, *axes)))
    for name, channel in samples._asdict().items():
        axes = (3,) if name in vectors else ()
        expected.append((f"samples.{name}", channel, (*along, *axes)))
    expected += [(f"fixes.{k}", x, tuple(timing.index.shape)) for k, x in fixes._asdict().items()]
    check_shapes(expected, f"{batch} drives and error states {', '.join(layout.names)}")
    check_channels(samples, fixes, timing)
    check_bounds(samples, fixes, timing, (start.state.lat, start.state.lon))
    _check_units(samples)
    check_covariance(start.covariance)


def _check_units(samples: ImuSample) -> None:
    there = samples.dt > 0.0
    count = there.sum(1).clamp(min=1)
    turn = samples.omega_ib_b.detach().norm(dim=-1)
    fast = ((turn > FASTEST_TURN) & there).sum(1) > 0.01 * count
    if bool(fast.any()):
        row = int(fast.nonzero()[0])
        raise LogError(
            f"filter: samples.omega_ib_b of drive {row} is up to {float(turn[row].max()):.3g} and "
            f"above {FASTEST_TURN:g} rad/s for more than a hundredth of the drive; no car turns so "
            "fast: convert degrees per second with math.radians"
        )
    square = (samples.f_b.detach().square().sum(-1) * there).sum(1) / count
    force = square.sqrt()
    off = there.any(1) & ((force < LIGHTEST) | (force > HEAVIEST))
    if bool(off.any()):
        row = int(off.nonzero()[0])
        raise LogError(
            f"filter: the specific force of drive {row} is {float(force[row]):.3g} m/s² (root mean "
            f"square); expected about 9.8: near 1 it is in g, near 0 gravity has been removed, far "
            "above it is no car's: samples.f_b is what accelerometers feel, (0, 0, +g) at rest"
        )


def check_ins_history(model: InsFilterModel, history: InsHistory, samples: ImuSample) -> None:
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
    warn_of_noise(model, history.nis, NOISE_BEHIND, "InsNoiseOptions")
