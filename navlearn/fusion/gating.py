"""Which measurements are believed: the χ² gate on each kind's innovation, and when it resets.

Thresholds in metres (:mod:`navlearn.fusion.integrity`) refuse beside the gate, and count towards
its reset; what is believed may count for less (:mod:`navlearn.fusion.robust`).
"""

from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.integrity import with_reason
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Rows, Verdict, believed
from navlearn.fusion.robust import weights, with_less_weight


class Gated(Protocol):
    """A filter whose measurements pass a gate.

    Attributes:
        rows: Rows of each kind of measurement.
        limits: Largest NIS that passes, per kind taken.
        gate: When a measurement is refused.
        anchor: Kind that vouches for the filter: where it is measured, the others reset with it
            and only with it. None lets every kind reset for itself.
        company: Kinds that are believed together with an anchor that resets; the others are not
            listened to at that moment.
    """

    @property
    def rows(self) -> Rows: ...  # noqa: D102

    @property
    def limits(self) -> tuple[float, ...]: ...  # noqa: D102

    @property
    def gate(self) -> GateOptions: ...  # noqa: D102

    @property
    def anchor(self) -> int | None: ...  # noqa: D102

    @property
    def company(self) -> tuple[int, ...]: ...  # noqa: D102


class Judged(NamedTuple):
    """What the gate says, per kind.

    Attributes:
        nis: Normalised innovation squared, NaN where nothing is measured, shape (..., kinds).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, int64, shape (..., kinds).
        refused: Consecutive refusals so far, shape (..., kinds).
        weight: How much each kind counts, 1 as its variance says, shape (..., kinds); None where
            the gate does not weigh.
    """

    nis: Tensor
    verdict: Tensor
    refused: Tensor
    weight: Tensor | None = None


def nis_by_kind(model: Gated, measured: Measured, innovation: Tensor, spread: Tensor) -> Tensor:
    """Return the NIS of each kind against the prediction.

    Args:
        model: The filter.
        measured: What is measured, shape (...).
        innovation: Measured minus predicted, shape (..., r).
        spread: H P Hᵀ of the prediction's covariance P, shape (..., r, r).

    Returns:
        NIS, zero where nothing is measured, shape (..., kinds).
    """
    owner, together = _owner(model.rows, innovation.dtype, innovation.device)
    if measured.extra is not None:
        spread = spread + measured.extra
    total = spread * together + torch.diag_embed(measured.variance)
    factor = torch.linalg.cholesky_ex(total)[0]
    white = torch.linalg.solve_triangular(factor, innovation.unsqueeze(-1), upper=False)
    nis: Tensor = (white * white).squeeze(-1) @ owner
    return nis


@lru_cache(maxsize=64)
def _owner(rows: Rows, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return which kind each row belongs to (r, kinds), and which rows belong together (r, r)."""
    with torch.inference_mode(False):
        owner = rows.spread(torch.eye(rows.known, dtype=dtype, device=device)).T
        return owner, owner @ owner.T


def limits_by_kind(model: Gated, like: Tensor) -> Tensor:
    """Return the largest NIS that passes, per kind.

    Args:
        model: The filter.
        like: Any tensor of the dtype and device wanted.

    Returns:
        Limits, infinite for kinds not taken, shape (kinds,).
    """
    return _limits(model.rows, model.limits, like.dtype, like.device)


@lru_cache(maxsize=64)
def _limits(
    rows: Rows, limits: tuple[float, ...], dtype: torch.dtype, device: torch.device
) -> Tensor:
    taken: dict[IntEnum | int, float] = dict(zip(rows.kinds, limits, strict=True))
    values = [taken.get(k, float("inf")) for k in range(rows.known)]
    with torch.inference_mode(False):
        return torch.tensor(values, dtype=dtype, device=device)


def judged(
    model: Gated, nis: Tensor, present: Tensor, refused: Tensor, *, faults: Tensor | None = None
) -> Judged:
    """Return which kinds pass the gate at one time.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (..., kinds).
        present: 1.0 where a kind is measured, shape (..., kinds).
        refused: Consecutive refusals before, shape (..., kinds).
        faults: What thresholds in metres refuse, int64, shape (..., kinds); None where there are
            none (:func:`navlearn.fusion.integrity.position_faults`).

    Returns:
        Verdicts, the refusals afterwards, and weights.
    """
    there = present > 0.5
    beyond = beyond_limits(model, nis, there, faults)
    # nothing begins anew by what is no number, however long it is refused
    finite = torch.isfinite(nis)
    patient = (refused >= model.gate.reset_after) & finite
    begun = torch.zeros_like(there[..., :1])
    if model.anchor is not None:
        anchor = slice(model.anchor, model.anchor + 1)
        begun = (beyond & patient)[..., anchor]
        patient = torch.where(there[..., anchor], begun, patient)
    alone = there & begun & ~_company(model, there)
    reset = beyond & patient & finite & ~alone
    gate = (beyond & ~reset) | alone
    verdict = there.to(torch.int64) * int(Verdict.ACCEPTED)
    verdict = torch.where(gate, int(Verdict.REFUSED_BY_GATE), verdict)
    verdict = torch.where(reset, int(Verdict.ACCEPTED_BY_RESET), verdict)
    count = torch.where(gate & ~alone, refused + 1.0, torch.where(there, 0.0, refused))
    return weighed(model, torch.where(there, nis, torch.nan), with_reason(verdict, faults), count)


def beyond_limits(model: Gated, nis: Tensor, there: Tensor, faults: Tensor | None) -> Tensor:
    """Return what is to be refused unless the gate resets, bool, shape (..., kinds).

    Args:
        model: The filter.
        nis: NIS of each kind, shape (..., kinds).
        there: Whether a kind is measured, bool, shape (..., kinds).
        faults: What thresholds in metres refuse, or None.
    """
    beyond = there & ~(nis.detach() <= limits_by_kind(model, nis))
    return beyond if faults is None else beyond | (there & (faults > 0))


def weighed(model: Gated, nis: Tensor, verdict: Tensor, refused: Tensor) -> Judged:
    """Return verdicts with the weights of what is believed.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (..., kinds).
        verdict: Verdicts, shape (..., kinds).
        refused: Consecutive refusals so far, shape (..., kinds).
    """
    weight = weights(model.gate, model.rows, nis, verdict)
    return Judged(nis, with_less_weight(verdict, weight), refused, weight)


def _company(model: Gated, like: Tensor) -> Tensor:
    """Return which kinds are listened to where the anchor resets, bool, shape (kinds,)."""
    listened = torch.zeros(like.shape[-1], dtype=torch.bool, device=like.device)
    for kind in (model.anchor, *model.company):
        if kind is not None:
            listened[kind] = True
    return listened


def taken(
    model: Gated, measured: Measured, verdict: Tensor, weight: Tensor | None = None
) -> Measured:
    """Return measurements with the refused ones blanked out, the others as they count.

    Args:
        model: The filter.
        measured: What is measured, shape (...).
        verdict: Verdict per kind, shape (..., kinds).
        weight: Weight per kind, shape (..., kinds); None takes variances as they are told.

    Returns:
        Measurements whose refused rows are zero with unit variance.
    """
    keep = model.rows.spread(believed(verdict))
    variance = measured.variance
    if weight is not None:
        variance = variance / model.rows.spread(weight)
    extra = measured.extra
    if extra is not None:
        extra = torch.where(keep.unsqueeze(-1) & keep.unsqueeze(-2), extra, 0.0)
    return Measured(
        torch.where(keep, measured.innovation, 0.0),
        torch.where(keep.unsqueeze(-1), measured.observation, 0.0),
        torch.where(keep, variance, 1.0),
        measured.present,
        extra,
    )
