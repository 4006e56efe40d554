"""The log-likelihood of a drive's measurements by a filter, kind by kind and block by block.

Noise is learned by making it large, on drives without any reference, [Mehra1970]. The filter runs
all blocks at once. The gate's verdicts are given: within one search for better noise they are
those with which it began, so that the likelihood has no steps; every measurement is counted,
believed or refused (see :mod:`navlearn.filters.likelihood`).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FilterDivergedError
from navlearn.filters.belief import Belief, map_belief
from navlearn.filters.ekf import projected
from navlearn.filters.likelihood import gaussian_log_density, student_log_density, whitened
from navlearn.fusion.fast import largest_move
from navlearn.fusion.fast_pass import Pass, beliefs_of, linearised_pass
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.gating import Judged
from navlearn.fusion.history import FilterHistory
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Rows, believed
from navlearn.fusion.noise import EkfNoise
from navlearn.fusion.record import starts_of_blocks
from navlearn.fusion.timeline import Timeline
from navlearn.fusion.updates import measured

MOST_PASSES = 30
"""Passes after which frozen verdicts are taken to have no solution."""

CLOSE = 0.1
"""Largest move of a block's start, m, after which two passes with gradients are exact enough."""


@dataclass(frozen=True, kw_only=True)
class LikelihoodOptions:
    """How innovations are judged.

    Attributes:
        freedom: Degrees of freedom of Student's density; infinite is the normal density, which a
            single wild fix may rule.
    """

    freedom: float = 5.0

    def __post_init__(self) -> None:
        """Refuse what is no density.

        Raises:
            ConfigError: If ``freedom`` is not positive.
        """
        if not self.freedom > 0.0:
            raise ConfigError(
                f"LikelihoodOptions.freedom: found {self.freedom}; expected more than 0"
            )


class Foretold(NamedTuple):
    """A drive's measurements as foretold by a filter.

    Attributes:
        log_likelihood: Per kind, nats, zero where nothing was measured, shape (B, K, kinds).
        begin: Beliefs at which blocks start, without gradients: where to go on from with nearly
            the same noise, batch shape (B, K).
    """

    log_likelihood: Tensor
    begin: Belief


def log_likelihood_by_kind(
    rows: Rows,
    found: Measured,
    spread: Tensor,
    verdict: Tensor,
    options: LikelihoodOptions | None = None,
) -> Tensor:
    """Return the log-density of what was measured, per kind, each given the kinds before it.

    Args:
        rows: Rows of each kind.
        found: Innovation, H, R and what is there, shape (...).
        spread: H P Hᵀ of the prediction, shape (..., r, r).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, shape (..., kinds).
            Refused kinds are counted by themselves, and no other is judged by them.
        options: Which density; None means the defaults.

    Returns:
        Log-densities, nats, zero where nothing was measured, shape (..., kinds).
    """
    options = options or LikelihoodOptions()
    owner = rows.spread(torch.eye(rows.known, dtype=spread.dtype, device=spread.device)).T
    used = rows.spread(believed(verdict).to(spread))
    together = torch.maximum(owner @ owner.T, used.unsqueeze(-1) * used.unsqueeze(-2))
    white = whitened(found.innovation, spread, found.variance, together)
    there = rows.spread(found.present)
    degrees = there @ owner
    square, log_variance = (white.square * there) @ owner, (white.log_variance * there) @ owner
    if math.isinf(options.freedom):
        return gaussian_log_density(square, log_variance, degrees)
    return student_log_density(square, log_variance, degrees, options.freedom)


def history_log_likelihood(
    model: FilterModel,
    line: Timeline,
    history: FilterHistory,
    noise: EkfNoise,
    options: LikelihoodOptions | None = None,
) -> Tensor:
    """Return the log-likelihood of a run that any form of the filter has made.

    Args:
        model: The filter, with closed feedback.
        line: The drives in blocks.
        history: The run, with a batch axis.
        noise: Noise of the run.
        options: Which density; None means the defaults.

    Returns:
        Log-densities, nats, zero where nothing was measured, shape (B, K, kinds).
    """
    prior = history.prior
    found = measured(model.measurement, prior, line.occasion, noise)
    _, spread = projected(prior.covariance, found.observation)
    innovation = torch.nan_to_num(history.innovation, nan=0.0)
    found = found._replace(innovation=innovation)
    return log_likelihood_by_kind(model.rows, found, spread, history.verdict, options)


def foretold(
    model: FilterModel,
    start: Belief,
    line: Timeline,
    noise: EkfNoise,
    begin: Belief,
    said: Judged,
    options: LikelihoodOptions | None = None,
) -> Foretold:
    """Return the log-likelihood of drives with the gate's verdicts given.

    Args:
        model: The filter, with closed feedback.
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations; gradients flow to them and to ``start``.
        begin: Guess of the beliefs at which blocks start, batch shape (B, K).
        said: What is believed, and how much it counts, shape (B, K, kinds).
        options: Which density; None means the defaults.

    Returns:
        Log-likelihood and where the filter came out.

    Raises:
        ConfigError: The filter runs with open feedback.
        FilterDivergedError: The passes do not converge, or a figure is not finite.
    """
    if not model.closed:
        raise ConfigError(
            "innovation likelihood: found feedback 'open'; the passes over all blocks at once need "
            "feedback 'closed', whose noise may be used with either"
        )
    if torch.is_grad_enabled():
        with torch.no_grad():
            begin = _converged(model, start, line, noise, begin, said)[0]
        # the first pass carries what data do to states, the second what states do to the model
        done = linearised_pass(model, start, begin, line, noise, said, 1)
        begin = starts_of_blocks(start, beliefs_of(model, start, line, done).belief)
        done = linearised_pass(model, start, begin, line, noise, said, 1)
    else:
        begin, done = _converged(model, start, line, noise, begin, said)
    _, spread = projected(done.behind.filtered.prior_covariance, done.found.observation)
    found = done.found._replace(innovation=done.behind.innovation)
    by_kind = log_likelihood_by_kind(model.rows, found, spread, said.verdict, options)
    if not bool(torch.isfinite(by_kind).all()):
        raise FilterDivergedError(
            "innovation likelihood: a log-density is not finite; the noise is out of all "
            "proportion to the drive"
        )
    return Foretold(by_kind, map_belief(begin, Tensor.detach))


def _converged(
    model: FilterModel,
    start: Belief,
    line: Timeline,
    noise: EkfNoise,
    begin: Belief,
    said: Judged,
) -> tuple[Belief, Pass]:
    move = math.inf
    for _ in range(MOST_PASSES):
        done = linearised_pass(model, start, begin, line, noise, said, 1)
        new = starts_of_blocks(start, beliefs_of(model, start, line, done).belief)
        move = largest_move(new, begin)
        begin = new
        if move < CLOSE:
            return begin, done
        if not math.isfinite(move):
            break
    raise FilterDivergedError(
        f"innovation likelihood: the filter does not settle (blocks still move by {move:.3g} m "
        f"after {MOST_PASSES} passes); the noise is out of all proportion to the drive"
    )
