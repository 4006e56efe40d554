"""One gated update: judge each kind of measurement, blank what is refused, correct by the rest."""

from collections.abc import Callable

import torch
from torch import Tensor

from navlearn.filters.ekf import Corrected, corrected, gain_of_projected, projected, update
from navlearn.fusion.gating import Gated, Judged, judged, nis_by_kind, taken
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.updates import Measured


def gated_update(
    model: Gated,
    covariance: Tensor,
    refused: Tensor,
    found: Measured,
    opened: Callable[[Tensor], Tensor],
) -> tuple[Corrected, Judged]:
    """Return correction and covariance of one update behind the gate.

    Args:
        model: The filter's gate and rows.
        covariance: P before the update, shape (..., n, n).
        refused: Consecutive refusals before, shape (..., kinds).
        found: What is measured, shape (...).
        opened: Gives the variance added where the gate resets, shape (..., n), from the verdicts.

    Returns:
        Correction with covariance and gain, and what the gate said.
    """
    cross, spread = projected(covariance, found.observation)
    nis = nis_by_kind(model, found, found.innovation, spread)
    verdict = judged(model, nis, found.present, refused)
    if not bool((verdict.verdict > int(Verdict.ACCEPTED)).any()):
        gain = gain_of_projected(cross, spread, found.variance)
        H, R = found.observation, found.variance
        return corrected(covariance, H, R, found.innovation, gain), verdict
    used = taken(model, found, verdict.verdict)
    if bool((verdict.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        covariance = covariance + torch.diag_embed(opened(verdict.verdict))
    return update(covariance, used.observation, used.variance, used.innovation), verdict
