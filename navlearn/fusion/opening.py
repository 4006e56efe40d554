"""What the RISS filter forgets where its gate resets: the variance that is added."""

import torch
from torch import Tensor

from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Kind, Verdict


def opened(model: FilterModel, verdict: Tensor, measured: Measured, innovation: Tensor) -> Tensor:
    """Return the variance added where the gate resets.

    The states that a kind observes get their innovation squared; azimuth, through which a car
    drifts, gets ``reset_azimuth``.

    Args:
        model: The filter.
        verdict: Verdict per kind, shape (..., kinds).
        measured: What is measured, shape (...).
        innovation: Measured minus predicted, shape (..., r).

    Returns:
        Diagonal of a covariance, shape (..., n).
    """
    layout = model.layout
    reset = (verdict == int(Verdict.ACCEPTED_BY_RESET)).to(innovation)
    square = (innovation * innovation).detach() * model.rows.spread(reset)
    extra = [torch.zeros_like(innovation[..., 0])] * layout.size
    azimuth = model.gate.reset_azimuth**2
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
