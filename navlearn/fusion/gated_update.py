"""One gated update: judge each kind of measurement, blank what is refused, correct by the rest."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.filters.ekf import Corrected, corrected, gain_of_projected, projected
from navlearn.fusion.gating import Gated, Judged, judged, nis_by_kind, taken
from navlearn.fusion.integrity import position_faults
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Verdict


class Believed(NamedTuple):
    """What the gate lets pass.

    Attributes:
        used: Measurements with the refused ones blanked out, the others as they count, shape
            (...).
        opened: Variance added because the gate resets, shape (..., n), or None where it does not.
        judged: What the gate said.
    """

    used: Measured
    opened: Tensor | None
    judged: Judged


def believed(
    model: Gated,
    spread: Tensor,
    refused: Tensor,
    found: Measured,
    opened: Callable[[Tensor], Tensor],
) -> Believed:
    """Return what of the measurements is to be used.

    Args:
        model: The filter's gate and rows.
        spread: H P Hᵀ, shape (..., r, r).
        refused: Consecutive refusals before, shape (..., kinds).
        found: What is measured, shape (...).
        opened: Gives the variance added where the gate resets, shape (..., n), from the verdicts.

    Returns:
        What passes.
    """
    nis = nis_by_kind(model, found, found.innovation, spread)
    faults = position_faults(model.gate, model.rows, found)
    verdict = judged(model, nis, found.present, refused, faults=faults)
    if verdict.weight is None and not bool((verdict.verdict > int(Verdict.ACCEPTED)).any()):
        return Believed(found, None, verdict)
    more = None
    if bool((verdict.verdict == int(Verdict.ACCEPTED_BY_RESET)).any()):
        more = opened(verdict.verdict)
    return Believed(taken(model, found, verdict.verdict, verdict.weight), more, verdict)


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
        found: What is measured, shape (...); a filter that leaves ``extra`` updates by the root
            of its covariance instead.
        opened: Gives the variance added where the gate resets, shape (..., n), from the verdicts.

    Returns:
        Correction with covariance and gain, and what the gate said.
    """
    cross, spread = projected(covariance, found.observation)
    used, more, verdict = believed(model, spread, refused, found, opened)
    if more is not None:
        covariance = covariance + torch.diag_embed(more)
    if used is not found:
        cross, spread = projected(covariance, used.observation)
    gain = gain_of_projected(cross, spread, used.variance)
    H, R = used.observation, used.variance
    return corrected(covariance, H, R, used.innovation, gain), verdict
