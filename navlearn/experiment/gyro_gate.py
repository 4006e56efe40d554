"""Corrected gyros judged in the past: emulated outages with and without what was learned before.

At each origin the model rests on what lay before it; the outage emulated there is mechanized once
as the filter stood, and once with the corrected gyro and the azimuth and bias that go with it.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel
from navlearn.filters.belief import Belief
from navlearn.frames import enu_between
from navlearn.fusion.error_state import ErrorLayout, error_layout
from navlearn.learning.gyro_past import GyroPast, at_samples, averaged_channels
from navlearn.learning.gyro_rate import GyroFit
from navlearn.navigator import Navigator, NavigatorRun, belief_at
from navlearn.states import RissSample, Trajectory


def past_origins(
    run: NavigatorRun, *, gone: int, length: int, every: int, after: int, least_distance: float
) -> list[int]:
    """Return blocks of the past, ending with fixes, at which emulated outages begin.

    They are placed backwards from the end, so that the latest past always judges.

    Args:
        run: The filter's run.
        gone: Only samples before this one are known by fixes.
        length: Samples of an emulated outage.
        every: Least samples between two starts.
        after: No outage starts earlier than this sample.
        least_distance: Outages in which the car drives less are left out, m.
    """
    ends = run.history.end
    way = torch.cumsum(run.samples.speed * run.samples.dt, 0)
    last = (ends + length).clamp(max=len(way) - 1)
    usable = (run.history.fix >= 0) & (ends + length < gone) & (ends >= after)
    usable &= way[last] - way[ends] >= least_distance
    chosen: list[int] = []
    limit = gone
    for block in reversed(torch.nonzero(usable).squeeze(-1).tolist()):
        if int(ends[block]) <= limit:
            chosen.append(block)
            limit = int(ends[block]) - every
    return chosen[::-1]


def errors_at_origins(
    navigator: Navigator,
    past: GyroPast,
    blocks: Sequence[int],
    fits: Sequence[GyroFit],
    length: int,
) -> tuple[Tensor, Tensor]:
    """Return the largest errors of emulated outages with and without what was learned, m.

    Args:
        navigator: What made the run.
        past: The drive's past.
        blocks: Blocks at whose ends the outages begin, B of them.
        fits: What was learned up to each.
        length: Samples of an emulated outage.

    Returns:
        Largest horizontal distance from what the filter knew later, shape (B,) each.
    """
    if not blocks:
        none = torch.zeros(0, dtype=torch.float64)
        return none, none
    run = past.run
    at = torch.tensor(list(blocks))
    rows = run.history.end[at].unsqueeze(-1) + 1 + torch.arange(length)
    samples = RissSample(*(channel[rows] for channel in run.samples))
    reference = Trajectory(*(channel[rows] for channel in run.history.trajectory))
    belief = belief_at(run.history, at)
    told = [
        rate_error(past, fit.fitted, int(row[0]), int(row[-1]) + 1)
        for fit, row in zip(fits, rows, strict=True)
    ]
    with_model = navigator.coast(restarted(belief, fits, navigator), samples, torch.stack(told))
    without = navigator.coast(belief, samples)
    corrected, plain = _largest(with_model, reference), _largest(without, reference)
    # A model without terms leaves the filter as it is.
    has_terms = torch.tensor([bool(fit.fitted.options.terms) for fit in fits])
    return torch.where(has_terms, corrected, plain), plain


def rate_error(past: GyroPast, fitted: FittedErrorModel, begin: int, stop: int) -> Tensor:
    """Return the gyro-rate error that a model tells at some samples of a run, rad/s.

    Args:
        past: Channels and averages of the model; samples after its end may be asked for.
        fitted: The model.
        begin: First sample.
        stop: The sample after the last.

    Returns:
        Shape (stop − begin,).
    """
    # From a whole row of averages on, so that rows are those of training.
    first = begin // past.block * past.block
    part = RissSample(*(channel[first:stop] for channel in past.run.samples))
    with torch.no_grad():
        told: Tensor = fitted.model(averaged_channels(part, past.inputs, past.block))
    return at_samples(told[:, 0], past.block, stop - first)[begin - first :]


def restarted(belief: Belief, fits: Sequence[GyroFit], navigator: Navigator) -> Belief:
    """Return beliefs with azimuth and gyro bias as regressions leave them.

    Args:
        belief: What the filter believed at the origins, shape (B,).
        fits: What was learned up to each.
        navigator: The filter.
    """
    layout = error_layout(navigator.options.filter)
    azimuth = torch.stack([fit.azimuth for fit in fits])
    turns = torch.round((belief.state.azimuth - azimuth) / (2.0 * math.pi))
    sensor = belief.sensor.clone()
    if "gyro_bias" in layout.sensors:
        place = layout.sensors.index("gyro_bias")
        sensor[..., place] = torch.stack([fit.gyro_bias for fit in fits])
    return belief._replace(
        state=belief.state._replace(azimuth=azimuth + 2.0 * math.pi * turns),
        sensor=sensor,
        covariance=_covariance(belief.covariance, fits, layout),
    )


def _covariance(old: Tensor, fits: Sequence[GyroFit], layout: ErrorLayout) -> Tensor:
    """Return covariances with those of azimuth and bias replaced, free of the other errors."""
    spread = torch.stack([fit.covariance for fit in fits])
    places = [layout.azimuth]
    if "gyro_bias" in layout.names:
        places.append(layout.names.index("gyro_bias"))
    new = old.clone()
    new[..., places, :] = 0.0
    new[..., :, places] = 0.0
    for i, a in enumerate(places):
        for j, b in enumerate(places):
            new[..., a, b] = spread[..., i, j]
    return new


def _largest(trajectory: Trajectory, reference: Trajectory) -> Tensor:
    east, north, _ = enu_between(
        trajectory.lat, trajectory.lon, trajectory.height,
        reference.lat, reference.lon, reference.height,
    )  # fmt: skip
    return torch.hypot(east, north).amax(-1)
