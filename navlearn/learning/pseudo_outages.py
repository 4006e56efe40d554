"""Emulated outages: what an error model learns from while GNSS is there.

From every tenth second of the filter's past the car is mechanized on without fixes; how far that
strays from what the filter knew later is the error that an outage starting there would have had.
Nothing after the last sample given is looked at, so training before an outage stays before it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.error_models.regressors import average_samples, build_regressors
from navlearn.errors import ConfigError, FitError
from navlearn.filters.belief import Belief
from navlearn.frames import enu_between
from navlearn.fusion.loosely_coupled import map_belief
from navlearn.learning.windows import Windows
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.states import RissSample, Trajectory

OUTPUTS = {"position": ("along", "cross"), "azimuth_rate": ("azimuth",)}
"""What a model that acts on something puts out, per step."""


@dataclass(frozen=True, kw_only=True)
class PseudoOutageOptions:
    """How outages are emulated.

    Attributes:
        horizon: Length of each, s.
        every: Time between their starts, s.
        step: Time between rows of regressors and targets, s.
        window: How far back their starts reach from the end, s; infinite for the whole past.
        minimum_distance: A shorter drive through the horizon is left out, m: a parked car
            teaches nothing.
        settle: Time after alignment in which none starts, s.
        max_fix_interval: One in which fixes are farther apart is left out, s: there the filter
            itself did not know where the car was.
    """

    horizon: float = 60.0
    every: float = 10.0
    step: float = 1.0
    window: float = float("inf")
    minimum_distance: float = 60.0
    settle: float = 60.0
    max_fix_interval: float = 3.5

    def __post_init__(self) -> None:
        if not 0.0 < self.step <= self.horizon:
            raise ConfigError(
                f"pseudo-outages: step is {self.step} s and horizon {self.horizon} s; expected "
                "0 < step <= horizon"
            )
        for name in ("every", "minimum_distance", "settle", "max_fix_interval"):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(
                    f"pseudo-outages: {name} is {getattr(self, name)}; expected zero or more"
                )


class PseudoOutages(NamedTuple):
    """N emulated outages of L samples, S steps.

    Attributes:
        belief: What the filter believed at their starts, batch shape (N,).
        samples: Sensor intervals through them, shape (N, L) each.
        predicted: The mechanized trajectory, shape (N, L) each.
        reference: What the filter knew later, shape (N, L) each.
        start_time: Starts, on the clock of ``begin``, s, shape (N,).
        block: Samples per step.
    """

    belief: Belief
    samples: RissSample
    predicted: Trajectory
    reference: Trajectory
    start_time: Tensor
    block: int


def emulate_outages(
    navigator: Navigator,
    run: NavigatorRun,
    options: PseudoOutageOptions,
    *,
    end: int | None = None,
    begin: float = 0.0,
) -> PseudoOutages:
    """Mechanize without fixes from many moments of a run.

    Args:
        navigator: What made the run.
        run: A run with fixes.
        options: Lengths and distances.
        end: Only samples before this one (from the run's first) exist; None takes all.
        begin: When the run's first interval begins, s.

    Returns:
        The emulated outages, in order of time.

    Raises:
        FitError: The past is too short, or the car hardly moved.
    """
    samples, history = run.samples, run.history
    known = samples.dt.shape[-1] if end is None else end
    dt = float(samples.dt[:known].median())
    block = max(1, round(options.step / dt))
    length = round(options.horizon / options.step) * block
    starts, blocks = outage_starts(history.end, options, known, length, dt)
    rows = starts.unsqueeze(-1) + 1 + torch.arange(length)
    window = RissSample(*(channel[rows] for channel in samples))
    far = (window.speed * window.dt).sum(-1) >= options.minimum_distance
    since = samples_since_fix(history.end, history.fix, samples.dt.shape[-1])
    seen = (since[rows] * dt).amax(-1) <= options.max_fix_interval
    kept = far & seen
    if not bool(kept.any()):
        raise FitError(
            f"emulated outages: none of {len(starts)} before {known * dt:.0f} s drives "
            f"{options.minimum_distance:g} m in {options.horizon:g} s with fixes at most "
            f"{options.max_fix_interval:g} s apart; start the outages later"
        )
    window = RissSample(*(channel[kept] for channel in window))
    belief = belief_at(history, blocks[kept])
    reference = Trajectory(*(channel[rows[kept]] for channel in history.trajectory))
    predicted = navigator.coast(belief, window)
    return PseudoOutages(
        belief, window, predicted, reference, begin + (starts[kept].double() + 1.0) * dt, block
    )


def samples_since_fix(end: Tensor, fix: Tensor, length: int) -> Tensor:
    """Return how many samples ago the last fix was, counted from the start before the first.

    Args:
        end: Last sample of each block of a filter's history, int64, shape (K,).
        fix: Fix at its end, −1 for none, int64, shape (K,).
        length: Number of samples T.

    Returns:
        int64, shape (T,).
    """
    last = torch.full((length,), -1)
    with_fix = end[fix >= 0]
    last[with_fix] = with_fix
    return torch.arange(length) - torch.cummax(last, 0).values


def outage_starts(
    end: Tensor, options: PseudoOutageOptions, known: int, length: int, dt: float
) -> tuple[Tensor, Tensor]:
    """Return the last sample before each emulated outage, and the block that ends there.

    Args:
        end: Last sample of each block of a filter's history, int64, shape (K,).
        options: Lengths and distances.
        known: Only samples before this one exist.
        length: Samples of an emulated outage.
        dt: Length of a sample, s.

    Raises:
        FitError: The past is too short.
    """
    first = round(options.settle / dt)
    if options.window < known * dt:
        first = max(first, known - round(options.window / dt))
    usable = torch.nonzero((end >= first) & (end + length < known)).squeeze(-1)
    if len(usable) == 0:
        raise FitError(
            f"emulated outages: {known * dt:.0f} s of filtering hold none of {options.horizon:g} s "
            f"after {options.settle:g} s to settle; start the outages later"
        )
    chosen, last = [], -float("inf")
    for block in usable.tolist():
        if (int(end[block]) - last) * dt >= options.every - 0.5 * dt:
            chosen.append(block)
            last = int(end[block])
    blocks = torch.tensor(chosen)
    return end[blocks], blocks


def error_increments(outages: PseudoOutages, acts_on: str) -> Tensor:
    """Return what the error grew by in every step.

    Args:
        outages: Emulated outages.
        acts_on: ``position``: metres along and to the right of the predicted azimuth at the end
            of each step; ``azimuth_rate``: rad.

    Returns:
        Increments, shape (N, S, p).

    Raises:
        ConfigError: ``acts_on`` is another word.
    """
    if acts_on not in OUTPUTS:
        raise ConfigError(f"acts_on: found {acts_on!r}; expected one of {', '.join(OUTPUTS)}")
    at = slice(outages.block - 1, None, outages.block)
    predicted = Trajectory(*(channel[:, at] for channel in outages.predicted))
    reference = Trajectory(*(channel[:, at] for channel in outages.reference))
    if acts_on == "azimuth_rate":
        error = _increments(predicted.azimuth - reference.azimuth)
        return wrap_angle(error).unsqueeze(-1)
    east, north, _ = enu_between(
        predicted.lat,
        predicted.lon,
        predicted.height,
        reference.lat,
        reference.lon,
        reference.height,
    )
    d_east, d_north = _increments(east), _increments(north)
    sin, cos = torch.sin(predicted.azimuth), torch.cos(predicted.azimuth)
    return torch.stack((d_east * sin + d_north * cos, d_east * cos - d_north * sin), -1)


def _increments(total: Tensor) -> Tensor:
    return torch.diff(total, dim=-1, prepend=torch.zeros_like(total[..., :1]))


def select_outages(outages: PseudoOutages, index: Tensor) -> PseudoOutages:
    """Return some of the emulated outages.

    Args:
        outages: Emulated outages.
        index: Which, int64, shape (N',), or bool, shape (N,).
    """
    return PseudoOutages(
        map_belief(outages.belief, lambda channel: channel[index]),
        RissSample(*(channel[index] for channel in outages.samples)),
        Trajectory(*(channel[index] for channel in outages.predicted)),
        Trajectory(*(channel[index] for channel in outages.reference)),
        outages.start_time[index],
        outages.block,
    )


def step_regressors(samples: RissSample, names: tuple[str, ...], block: int) -> Tensor:
    """Return regressors per step through an outage that starts with the samples.

    Args:
        samples: Intervals, shape (..., L) each.
        names: Names of the regressors.
        block: Samples per step.

    Returns:
        Regressors, shape (..., S, m).
    """
    return build_regressors(average_samples(samples, block), names)


def training_windows(outages: PseudoOutages, inputs: tuple[str, ...], acts_on: str) -> Windows:
    """Return windows of regressors and error increments.

    Args:
        outages: Emulated outages.
        inputs: Names of the regressors.
        acts_on: What the model's output corrects.

    Returns:
        Windows, every row of weight one.
    """
    u = step_regressors(outages.samples, inputs, outages.block)
    y = error_increments(outages, acts_on)
    return Windows(u, y, torch.ones_like(y[..., 0]), outages.start_time)
