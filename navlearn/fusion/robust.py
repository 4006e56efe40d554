"""How much a measurement counts that is far from its prediction: Huber's and Student's weights.

What is believed is taken with its variance over a weight w ≤ 1, one for all m rows of a kind, from
the same NIS that the gate judges:

* Huber [Huber1964]: w = min(1, t/√NIS), with t² the NIS that as many good measurements of m rows
  exceed as those of one row exceed k deviations (k = ``robust_limit``);
* Student with ν degrees of freedom [Lange1989]: w = min(1, (ν + m)/(ν + NIS)).

Weights are those of one step, found from the prediction, and are not iterated about the updated
state. So a weight hangs on what came before the measurement alone, is told by the NIS in the
history, has a closed derivative, and is the same function in all forms of a filter; a filter that
has coasted long has a wide prediction, and takes a far fix for good, as it should. Iterated weights
minimise the robust cost exactly; where the prediction is surer than the fix, as it is while fixes
come, the two hardly differ. A weight never exceeds one: a fix that happens to fit is no better than
its receiver says, and a filter that believed it more would become too sure.
"""

from functools import lru_cache

import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.measurements import Rows, Verdict

LESS = 0.5
"""Weight below which a verdict says so: the variance is more than doubled."""


def weights(gate: GateOptions, rows: Rows, nis: Tensor, verdict: Tensor) -> Tensor | None:
    """Return how much what is believed counts.

    What a reset takes counts fully, as the covariance was opened to it.

    Args:
        gate: Which weights.
        rows: Rows of each kind of measurement.
        nis: NIS of each kind, NaN or anything where nothing is measured, shape (..., kinds).
        verdict: Verdicts, shape (..., kinds).

    Returns:
        Weights, 1 for what is not measured or refused, shape (..., kinds); None where the gate
        does not weigh.
    """
    if not gate.weighs:
        return None
    count, knee = _of_rows(gate, rows, nis.dtype, nis.device)
    plain = verdict == int(Verdict.ACCEPTED)
    plain = plain | (verdict == int(Verdict.ACCEPTED_WITH_LESS_WEIGHT))
    far = plain & (nis > knee)
    beyond = torch.where(far, nis, knee)
    if gate.robust == "huber":
        weight = torch.sqrt(knee / beyond)
    else:
        weight = (gate.freedom + count) / (gate.freedom + beyond)
    return torch.where(far, weight, 1.0)


@lru_cache(maxsize=64)
def _of_rows(
    gate: GateOptions, rows: Rows, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Return rows of each kind, and the NIS beyond which its weight falls, shape (kinds,)."""
    count = [1.0] * rows.known
    for kind, n in zip(rows.kinds, rows.count, strict=True):
        count[kind] = float(n)
    good = torch.special.erf(torch.tensor(gate.robust_limit, dtype=torch.float64) / 2.0**0.5)
    huber = gate.robust == "huber"
    knee = [chi_square_quantile(float(good), n) if huber else n for n in count]
    with torch.inference_mode(False):
        return (
            torch.tensor(count, dtype=dtype, device=device),
            torch.tensor(knee, dtype=dtype, device=device),
        )


def with_less_weight(verdict: Tensor, weight: Tensor | None) -> Tensor:
    """Return verdicts that say where something was taken with much less weight.

    Args:
        verdict: Verdicts per kind, shape (..., kinds).
        weight: What :func:`weights` found.
    """
    if weight is None:
        return verdict
    less = (verdict == int(Verdict.ACCEPTED)) & (weight.detach() < LESS)
    return torch.where(less, int(Verdict.ACCEPTED_WITH_LESS_WEIGHT), verdict)
