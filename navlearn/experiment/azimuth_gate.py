"""The gate of the azimuth models: would they have helped in the last emulated outages?"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from navlearn.error_models.safeguard import GateVerdict, rolling_origin_gate
from navlearn.errors import FitError
from navlearn.experiment.azimuth_filter import Beside, steer
from navlearn.experiment.azimuth_model import fit_azimuth
from navlearn.experiment.feed_forward import FeedForward
from navlearn.experiment.learned import pseudo_outage_options
from navlearn.frames import enu_between
from navlearn.learning.pseudo_outages import PseudoOutages, emulate_outages, select_outages
from navlearn.navigator import Navigator
from navlearn.states import Trajectory


def recent_outages(
    beside: Beside, navigator: Navigator, gone: int, begin: float
) -> PseudoOutages | None:
    """Return the last emulated outages; None where the spec has no gate, or the past none.

    They start half their length apart, so that a dozen of them reach back some minutes.

    Args:
        beside: The feed-forward filter.
        navigator: The honest filter's.
        gone: First interval without GNSS: nothing from there on is looked at.
        begin: When the run's first interval begins, s.
    """
    spec = beside.spec
    if not spec.safeguard.gate:
        return None
    options = pseudo_outage_options(beside.runs.recipe)
    options = replace(
        options,
        every=max(options.every, 0.5 * options.horizon),
        settle=max(options.settle, spec.window_s + 2.0 * options.step),
    )
    try:
        emulated = emulate_outages(navigator, beside.honest, options, end=gone, begin=begin)
    except FitError:
        return None
    count = len(emulated.start_time)
    return select_outages(emulated, torch.arange(max(count - spec.gate_replays, 0), count))


def verdict_on(
    beside: Beside, emulated: PseudoOutages | None, runs: list[FeedForward]
) -> GateVerdict:
    """Return whether the model may act.

    Args:
        beside: The feed-forward filter.
        emulated: The last emulated outages, or None.
        runs: The filter's runs over them and the windows before.
    """
    guard = beside.spec.safeguard
    if not guard.gate:
        return GateVerdict(use=True, improvement=math.nan, replays=0, margin=guard.gate_margin)
    none = torch.zeros(0, dtype=torch.float64)
    errors = (none, none) if emulated is None else replayed(beside, emulated, runs)
    return rolling_origin_gate(*errors, margin=guard.gate_margin, fewest=guard.gate_fewest)


def replayed(
    beside: Beside, emulated: PseudoOutages, runs: list[FeedForward]
) -> tuple[Tensor, Tensor]:
    """Return the largest error of emulated outages with the model and without.

    Args:
        beside: The feed-forward filter; its model is fitted anew before each outage.
        emulated: The emulated outages.
        runs: Its runs over them and the windows before.

    Returns:
        Errors with and without the model, m, shape (M,) each; outages before which nothing could
        be fitted are left out.
    """
    paths, kept = [], []
    for k, run in enumerate(runs):
        try:
            learned = fit_azimuth(beside.spec, beside.ekf.model, run, step=beside.step)
        except FitError:
            continue
        paths.append(steer(beside.options, run, learned))
        kept.append(k)
    if not kept:
        none = torch.zeros(0, dtype=torch.float64)
        return none, none
    emulated = select_outages(emulated, torch.tensor(kept))
    path = Trajectory(*(torch.stack(channel) for channel in zip(*paths, strict=True)))
    return _largest(path, emulated.reference), _largest(emulated.predicted, emulated.reference)


def _largest(path: Trajectory, reference: Trajectory) -> Tensor:
    east, north, _ = enu_between(
        path.lat, path.lon, path.height, reference.lat, reference.lon, reference.height
    )
    return torch.hypot(east, north).amax(-1)
