"""A linear filter over all blocks at once, behind the gate.

The gate judges innovations that depend on what it let through before. Verdicts are renewed within
the pass: a set of verdicts that reproduces itself is the one that a loop would have found, because
those at a block depend on earlier ones alone.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.chunks import Filtered
from navlearn.filters.ekf import projected
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.fusion.gating import Gated, Judged, nis_by_kind, taken
from navlearn.fusion.gating_over_time import judged_over_time
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.updates import Measured


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
        judged: The gate's verdicts on these innovations.
        used: The verdicts that were used to get there, shape (B, K, kinds).
    """

    filtered: Filtered
    innovation: Tensor
    judged: Judged
    used: Tensor

    @property
    def said(self) -> Tensor:
        """What the gate says now."""
        return self.judged.verdict

    @property
    def reproduced(self) -> bool:
        """Whether the gate says again what it had said."""
        return bool((self.judged.verdict == self.used).all())


def filtered_behind_gate(
    model: Gated,
    covariance: Tensor,
    refused: Tensor,
    blocks: Linearised,
    verdict: Tensor | None,
    rounds: int,
    opened: Callable[[Tensor, Tensor], Tensor],
) -> Behind:
    """Filter all blocks, and renew the gate's verdicts on them.

    Args:
        model: The filter's gate and rows.
        covariance: P before the first block, shape (B, n, n).
        refused: Consecutive refusals before the first block, shape (B, kinds).
        blocks: The linearised blocks.
        verdict: Verdicts to use, shape (B, K, kinds); None believes everything.
        rounds: How often at most verdicts are renewed.
        opened: Gives the variance added where the gate resets, shape (B, K, n), from verdicts and
            innovations.

    Returns:
        What was found.
    """
    found = blocks.found
    zero = torch.zeros_like(covariance[..., 0])
    if verdict is None:
        verdict = (found.present > 0.5).to(torch.int64) * int(Verdict.ACCEPTED)
    innovation = found.innovation
    while True:
        used = taken(model, found, verdict)
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
        new = judged_over_time(model, nis, found.present, refused)
        rounds -= 1
        done = Behind(filtered, innovation, new, verdict)
        if rounds <= 0 or done.reproduced:
            return done
        verdict = new.verdict
