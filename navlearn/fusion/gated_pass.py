"""A linear filter over all blocks at once, behind the gate.

The gate judges innovations that depend on what it let through before. Verdicts are renewed within
the pass: a set of verdicts that reproduces itself is the one that a loop would have found, because
those at a block depend on earlier ones alone. So with weights, which hang on the same innovations.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Filtered
from navlearn.filters.ekf import projected
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.filters.whitening import whitened
from navlearn.fusion.gating import Gated, Judged, nis_by_kind, taken
from navlearn.fusion.gating_over_time import judged_over_time
from navlearn.fusion.integrity import position_faults
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.robust import weights

NEARLY = 1e-6
"""By how much weights may differ that reproduce themselves."""

UNROLLED = 5
"""How often weights are renewed in a pass with gradients: each round carries what weights do to the
weights of later blocks one step further."""


class Linearised(NamedTuple):
    """Blocks linearised at a guess; deviations are from the blocks' predicted ends.

    Attributes:
        transition: Φ, shape (B, K, n, n).
        shift: By how much a block's end moves because the one before ends elsewhere than the
            block was guessed to start, shape (B, K, n).
        noise: Q, shape (B, K, n, n).
        found: What is measured at the predicted ends.
    """

    transition: Tensor
    shift: Tensor
    noise: Tensor
    found: Measured


class Behind(NamedTuple):
    """What the filter found behind the gate.

    Attributes:
        filtered: Deviations and covariances.
        innovation: Measured minus predicted by the filter, shape (B, K, r).
        judged: The gate's verdicts on these innovations, and weights.
        used: What was believed to get there.
    """

    filtered: Filtered
    innovation: Tensor
    judged: Judged
    used: Judged

    @property
    def said(self) -> Judged:
        """What the gate says now."""
        return self.judged

    @property
    def reproduced(self) -> bool:
        """Whether the gate says again what it had said."""
        return same_said(self.judged, self.used)


def same_said(said: Judged, other: Judged) -> bool:
    """Return whether the same is believed: verdicts alike, and weights nearly.

    Args:
        said: What is believed.
        other: What was believed before.
    """
    alike = bool((said.verdict == other.verdict).all())
    if said.weight is None or other.weight is None:
        return alike and said.weight is other.weight
    return alike and bool(((said.weight - other.weight).abs() <= NEARLY).all())


def everything_believed(model: Gated, present: Tensor) -> Judged:
    """Return what is believed before anything is known.

    Args:
        model: The filter.
        present: 1.0 where a kind is measured, shape (B, K, kinds).
    """
    verdict = (present > 0.5).to(torch.int64) * int(Verdict.ACCEPTED)
    none = torch.zeros_like(present)
    return Judged(none, verdict, none, torch.ones_like(present) if model.gate.weighs else None)


def filtered_behind_gate(
    model: Gated,
    covariance: Tensor,
    refused: Tensor,
    blocks: Linearised,
    said: Judged | Tensor | None,
    rounds: int,
    opened: Callable[[Tensor, Tensor], Tensor],
) -> Behind:
    """Filter all blocks, and renew the gate's verdicts on them.

    Args:
        model: The filter's gate and rows.
        covariance: P before the first block, shape (B, n, n).
        refused: Consecutive refusals before the first block, shape (B, kinds).
        blocks: The linearised blocks.
        said: Verdicts and weights to use; verdicts alone, shape (B, K, kinds), whose weights are
            found along; None believes everything.
        rounds: How often at most they are renewed.
        opened: Gives the variance added where the gate resets, shape (B, K, n), from verdicts and
            innovations.

    Returns:
        What was found.
    """
    found = blocks.found
    zero = torch.zeros_like(covariance[..., 0])
    along = torch.is_grad_enabled() or isinstance(said, Tensor)
    unrolled = UNROLLED if model.gate.weighs and along else 0
    if said is None:
        said = everything_believed(model, found.present)
    elif isinstance(said, Tensor):
        said = everything_believed(model, found.present)._replace(verdict=said)
    innovation = found.innovation
    while True:
        verdict = said.verdict
        used = independent(taken(model, found, verdict, said.weight))
        total, extra = blocks.noise, torch.zeros_like(blocks.noise[..., :1, :1])
        if bool((verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
            extra = torch.diag_embed(opened(verdict, innovation))
            total = total + extra
        steps = LinearSteps(
            blocks.transition,
            blocks.shift,
            total,
            used.observation,
            used.variance,
            used.innovation,
        )
        filtered = filter_in_parallel(zero, covariance, steps)
        # a reset opens the covariance after the gate has judged
        filtered = filtered._replace(prior_covariance=filtered.prior_covariance - extra)
        told = (found.observation @ filtered.prior_mean.unsqueeze(-1)).squeeze(-1)
        innovation = found.innovation - told
        _, spread = projected(filtered.prior_covariance, found.observation)
        nis = nis_by_kind(model, found, innovation, spread)
        if unrolled > 0:
            unrolled -= 1
            said = said._replace(weight=weights(model.gate, model.rows, nis, verdict))
            continue
        faults = position_faults(model.gate, model.rows, found._replace(innovation=innovation))
        new = judged_over_time(model, nis, found.present, refused, faults=faults)
        rounds -= 1
        done = Behind(filtered, innovation, new, said)
        if rounds <= 0 or done.reproduced:
            return done
        said = new


def independent(measured: Measured) -> Measured:
    """Return measurements that tell the same, each with a noise of its own.

    Args:
        measured: What is used, its refused rows blank, shape (...).

    Returns:
        The same without ``extra``.
    """
    if measured.extra is None:
        return measured
    R = torch.diag_embed(measured.variance) + measured.extra
    H, innovation = whitened(measured.observation, R, measured.innovation)
    variance = torch.ones_like(measured.variance)
    return measured._replace(observation=H, innovation=innovation, variance=variance, extra=None)
