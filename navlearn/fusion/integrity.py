"""Position fixes refused by a threshold in metres, and which one refuses them.

[Ghouneem2024] Eq. (24): further than T_RISS from the prediction, or moved by T_GNSS otherwise than
the car (:mod:`navlearn.fusion.motion_check`). The prediction is that of the innovation, lever arm
and delay included. Where several tests refuse a fix, the verdict names the first in the order
prediction, motion, χ² gate.
"""

import torch
from torch import Tensor

from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measured import Measured
from navlearn.fusion.measurements import Kind, Rows, Verdict


def position_faults(gate: GateOptions, rows: Rows, found: Measured) -> Tensor | None:
    """Return which measurements are refused by a threshold in metres, and by which.

    Args:
        gate: Limits.
        rows: Rows of each kind of measurement; position comes first in every family of filters.
        found: What is measured against the prediction, shape (...).

    Returns:
        Codes of :class:`navlearn.fusion.measurements.Verdict`, 0 for none, int64, shape
        (..., kinds); None where there are no thresholds.
    """
    at = rows.of(Kind.POSITION)
    if at is None or not gate.tests_position:
        return None
    east, north, _ = found.innovation.detach()[..., at].unbind(-1)
    code = torch.zeros_like(east, dtype=torch.int64)
    if found.astray is not None:
        code = torch.where(found.astray > 0.5, int(Verdict.REFUSED_BY_MOTION), code)
    near = torch.hypot(east, north) <= gate.prediction_limit
    code = torch.where(near, code, int(Verdict.REFUSED_BY_PREDICTION))
    return torch.nn.functional.pad(code.unsqueeze(-1), (0, rows.known - 1))


def with_reason(verdict: Tensor, faults: Tensor | None) -> Tensor:
    """Return verdicts in which refusals name a threshold in metres where that came first.

    Args:
        verdict: Verdicts per kind, shape (..., kinds).
        faults: What :func:`position_faults` found.
    """
    if faults is None:
        return verdict
    named = (verdict == int(Verdict.REFUSED_BY_GATE)) & (faults > 0)
    return torch.where(named, faults, verdict)
