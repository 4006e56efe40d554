"""What a reception may mean: what begins anew, and which measurements agree if it does."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.fusion.measured import Measured
from navlearn.fusion.tight.agreement import agreement
from navlearn.fusion.tight.anew import Anew, told_by_clock
from navlearn.fusion.tight.model import TightModel


class Scene(NamedTuple):
    """What a reception is judged by.

    Attributes:
        model: The filter.
        found: What is measured, shape (...).
        spread: Covariance of the innovations, R included, shape (..., 2 S, 2 S).
        there: Whether something is measured, bool, shape (..., 2 S).
    """

    model: TightModel
    found: Measured
    spread: Tensor
    there: Tensor


class Hypothesis(NamedTuple):
    """What may have begun anew, and what agrees if it has.

    Attributes:
        anew: What began anew.
        accepted: What agrees, bool, shape (..., 2 S).
    """

    anew: Anew
    accepted: Tensor


def what_agrees(scene: Scene, anew: Anew) -> Hypothesis:
    """Return what agrees if something begins anew."""
    model, found = scene.model, scene.found
    left = found.innovation - told_by_clock(model, found, anew.shift)
    H = found.observation.detach()
    spread = scene.spread + (H * anew.variance.unsqueeze(-2)) @ H.transpose(-1, -2)
    return Hypothesis(anew, agreement(left, spread, scene.there, model.limit).accepted)


def more_agree(supposed: Hypothesis, plain: Hypothesis) -> Tensor:
    """Return whether more measurements agree with one hypothesis than with another."""
    return supposed.accepted.sum(-1) > plain.accepted.sum(-1)


def chosen(where: Tensor, one: Hypothesis, other: Hypothesis) -> Hypothesis:
    """Return one hypothesis where it is believed, bool, shape (...), and another elsewhere."""
    where = where.unsqueeze(-1)
    anew = (torch.where(where, a, b) for a, b in zip(one.anew, other.anew, strict=True))
    return Hypothesis(Anew(*anew), torch.where(where, one.accepted, other.accepted))


def groups(per_measurement: Tensor) -> Tensor:
    """Return pseudoranges and range rates apart, shape (..., 2, S)."""
    return per_measurement.reshape(*per_measurement.shape[:-1], 2, -1)


def most_refused(there: Tensor, accepted: Tensor) -> Tensor:
    """Return whether most pseudoranges, and most range rates, are refused, shape (..., 2)."""
    return 2 * groups(there & ~accepted).sum(-1) > groups(there).sum(-1)


def many_refused(there: Tensor, accepted: Tensor) -> Tensor:
    """Return whether many are refused, two and a third at least or the only one, shape (..., 2)."""
    out, seen = groups(there & ~accepted).sum(-1), groups(there).sum(-1)
    return (3 * out >= seen) & ((out >= 2) | (out == 1) & (seen == 1))
