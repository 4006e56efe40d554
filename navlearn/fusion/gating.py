"""Which measurements are believed: the χ² gate on each kind's innovation, and its reset."""

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.measurements import Kind, Rows, Verdict
from navlearn.fusion.updates import Measured


class Judged(NamedTuple):
    """What the gate says, per kind.

    Attributes:
        nis: Normalised innovation squared, NaN where nothing is measured, shape (..., 5).
        verdict: Codes of :class:`navlearn.fusion.measurements.Verdict`, int64, shape (..., 5).
        refused: Consecutive refusals so far, shape (..., 5).
    """

    nis: Tensor
    verdict: Tensor
    refused: Tensor


def nis_by_kind(
    model: FilterModel, measured: Measured, innovation: Tensor, spread: Tensor
) -> Tensor:
    """Return the NIS of each kind against the prediction.

    Args:
        model: The filter.
        measured: What is measured, shape (...).
        innovation: Measured minus predicted, shape (..., r).
        spread: H P Hᵀ of the prediction's covariance P, shape (..., r, r).

    Returns:
        NIS, zero where nothing is measured, shape (..., 5).
    """
    owner, together = _owner(model.rows, innovation.dtype, innovation.device)
    total = spread * together + torch.diag_embed(measured.variance)
    factor = torch.linalg.cholesky_ex(total)[0]
    white = torch.linalg.solve_triangular(factor, innovation.unsqueeze(-1), upper=False)
    nis: Tensor = (white * white).squeeze(-1) @ owner
    return nis


@lru_cache(maxsize=64)
def _owner(rows: Rows, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return which kind each row belongs to (r, 5), and which rows belong together (r, r)."""
    with torch.inference_mode(False):
        owner = rows.spread(torch.eye(len(Kind), dtype=dtype, device=device)).T
        return owner, owner @ owner.T


def limits_by_kind(model: FilterModel, like: Tensor) -> Tensor:
    """Return the largest NIS that passes, per kind.

    Args:
        model: The filter.
        like: Any tensor of the dtype and device wanted.

    Returns:
        Limits, infinite for kinds not taken, shape (5,).
    """
    return _limits(model.rows.kinds, model.limits, like.dtype, like.device)


@lru_cache(maxsize=64)
def _limits(
    kinds: tuple[Kind, ...], limits: tuple[float, ...], dtype: torch.dtype, device: torch.device
) -> Tensor:
    known = dict(zip(kinds, limits, strict=True))
    with torch.inference_mode(False):
        return torch.tensor([known.get(k, float("inf")) for k in Kind], dtype=dtype, device=device)


def judged(model: FilterModel, nis: Tensor, present: Tensor, refused: Tensor) -> Judged:
    """Return which kinds pass the gate at one time.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (..., 5).
        present: 1.0 where a kind is measured, shape (..., 5).
        refused: Consecutive refusals before, shape (..., 5).

    Returns:
        Verdicts and the refusals afterwards.
    """
    there = present > 0.5
    beyond = there & ~(nis.detach() <= limits_by_kind(model, nis))
    reset = beyond & (refused >= model.options.gate.reset_after)
    gate = beyond & ~reset
    verdict = there.to(torch.int64) * int(Verdict.ACCEPTED)
    verdict = torch.where(gate, int(Verdict.REFUSED_BY_GATE), verdict)
    verdict = torch.where(reset, int(Verdict.ACCEPTED_BY_RESET), verdict)
    count = torch.where(gate, refused + 1.0, torch.where(there, 0.0, refused))
    return Judged(torch.where(there, nis, torch.nan), verdict, count)


def judged_over_time(model: FilterModel, nis: Tensor, present: Tensor, refused: Tensor) -> Judged:
    """Return which kinds pass the gate at every block.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (B, K, 5).
        present: 1.0 where a kind is measured, shape (B, K, 5).
        refused: Consecutive refusals before the first block, shape (B, 5).

    Returns:
        Verdicts and the refusals after each block.
    """
    there = present > 0.5
    beyond = there & ~(nis.detach() <= limits_by_kind(model, nis))
    verdict = there.to(torch.int64) * int(Verdict.ACCEPTED)
    count = torch.zeros_like(nis)
    odd = beyond.any(1) | (refused > 0.5)
    for b, kind in odd.nonzero().tolist():
        column, counts = _judged_column(
            beyond[b, :, kind].tolist(),
            there[b, :, kind].tolist(),
            float(refused[b, kind]),
            model.options.gate.reset_after,
        )
        verdict[b, :, kind] = torch.tensor(column, device=verdict.device)
        count[b, :, kind] = torch.tensor(counts, dtype=count.dtype, device=count.device)
    return Judged(torch.where(there, nis, torch.nan), verdict, count)


def _judged_column(
    beyond: list[bool], there: list[bool], refused: float, reset_after: int
) -> tuple[list[int], list[float]]:
    verdicts, counts = [], []
    for wild, seen in zip(beyond, there, strict=True):
        verdict = Verdict.ABSENT
        if seen:
            verdict = Verdict.ACCEPTED
            if wild and refused < reset_after:
                verdict = Verdict.REFUSED_BY_GATE
            elif wild:
                verdict = Verdict.ACCEPTED_BY_RESET
            refused = refused + 1.0 if verdict == Verdict.REFUSED_BY_GATE else 0.0
        verdicts.append(int(verdict))
        counts.append(refused)
    return verdicts, counts


def taken(model: FilterModel, measured: Measured, verdict: Tensor) -> Measured:
    """Return measurements with the refused ones blanked out.

    Args:
        model: The filter.
        measured: What is measured, shape (...).
        verdict: Verdict per kind, shape (..., 5).

    Returns:
        Measurements whose refused rows are zero with unit variance.
    """
    fine = (verdict == int(Verdict.ACCEPTED)) | (verdict == int(Verdict.ACCEPTED_BY_RESET))
    keep = model.rows.spread(fine)
    return Measured(
        torch.where(keep, measured.innovation, 0.0),
        torch.where(keep.unsqueeze(-1), measured.observation, 0.0),
        torch.where(keep, measured.variance, 1.0),
        measured.present,
    )


def opened(model: FilterModel, verdict: Tensor, measured: Measured, innovation: Tensor) -> Tensor:
    """Return the variance added where the gate resets.

    The states that a kind observes get their innovation squared; azimuth, through which a car
    drifts, gets ``reset_azimuth``.

    Args:
        model: The filter.
        verdict: Verdict per kind, shape (..., 5).
        measured: What is measured, shape (...).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        Diagonal of a covariance, shape (..., n).
    """
    layout = model.layout
    reset = (verdict == int(Verdict.ACCEPTED_BY_RESET)).to(innovation)
    square = (innovation * innovation).detach() * model.rows.spread(reset)
    extra = [torch.zeros_like(innovation[..., 0])] * layout.size
    azimuth = model.options.gate.reset_azimuth**2
    for kind in model.rows.kinds:
        rows = model.rows.of(kind)
        if rows is None:
            continue
        part = square[..., rows]
        if kind == Kind.POSITION:
            extra[:3] = [extra[i] + part[..., i] for i in range(3)]
        if kind in (Kind.VELOCITY, Kind.ZERO_SPEED) and layout.has_velocity:
            # Two rows where fixes tell no vertical velocity.
            for i in range(part.shape[-1]):
                extra[3 + i] = extra[3 + i] + part[..., i]
        if kind in (Kind.POSITION, Kind.VELOCITY, Kind.COURSE):
            extra[layout.azimuth] = extra[layout.azimuth] + azimuth * reset[..., kind]
        if kind == Kind.ZERO_YAW_RATE:
            H = measured.observation[..., rows.start, :]
            weight = H * H / (H * H).sum(-1, keepdim=True).clamp(min=1e-12)
            extra = [
                x + w * part[..., 0] / h.square().clamp(min=1e-6)
                for x, w, h in zip(extra, weight.unbind(-1), H.unbind(-1), strict=True)
            ]
    return torch.stack(extra, -1)
