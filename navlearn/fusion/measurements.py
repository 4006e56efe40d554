"""The kinds of measurement a filter takes, and the rows each has.

Rows of all kinds stand together in one vector of fixed length. A measurement that is not there
has a zero row in H, a zero innovation and unit variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import torch
from torch import Tensor

from navlearn.fusion.options import EkfOptions


class Kind(IntEnum):
    """Kinds of measurement, in the order of every per-kind axis."""

    POSITION = 0
    VELOCITY = 1
    COURSE = 2
    ZERO_YAW_RATE = 3
    ZERO_SPEED = 4


class Verdict(IntEnum):
    """What became of a measurement.

    A refused one names its reason. One of less weight was taken with more than twice the variance
    that it told.
    """

    ABSENT = 0
    ACCEPTED = 1
    REFUSED_BY_GATE = 2
    ACCEPTED_BY_RESET = 3
    REFUSED_BY_PREDICTION = 4
    REFUSED_BY_MOTION = 5
    ACCEPTED_WITH_LESS_WEIGHT = 6


def believed(verdict: Tensor) -> Tensor:
    """Return whether measurements were taken, by a reset or with less weight among them.

    Args:
        verdict: Codes of :class:`Verdict`, shape (...).
    """
    codes = (Verdict.ACCEPTED, Verdict.ACCEPTED_BY_RESET, Verdict.ACCEPTED_WITH_LESS_WEIGHT)
    return _among(verdict, codes)


def refused(verdict: Tensor) -> Tensor:
    """Return whether measurements were refused, for whatever reason.

    Args:
        verdict: Codes of :class:`Verdict`, shape (...).
    """
    codes = (Verdict.REFUSED_BY_GATE, Verdict.REFUSED_BY_PREDICTION, Verdict.REFUSED_BY_MOTION)
    return _among(verdict, codes)


def _among(verdict: Tensor, codes: tuple[Verdict, ...]) -> Tensor:
    found = verdict == int(codes[0])
    for code in codes[1:]:
        found = found | (verdict == int(code))
    return found


@dataclass(frozen=True)
class Rows:
    """Which rows of the measurement vector belong to which kind.

    Attributes:
        kinds: Kinds that the filter takes, in the order of their rows.
        first: First row of each kind taken.
        count: Number of rows of each kind taken.
        known: Number of kinds that the family of filters knows, the length of per-kind axes.
    """

    kinds: tuple[IntEnum, ...]
    first: tuple[int, ...]
    count: tuple[int, ...]
    known: int = len(Kind)

    @property
    def size(self) -> int:
        """Length r of the measurement vector."""
        return sum(self.count)

    def of(self, kind: IntEnum) -> slice | None:
        """Return the rows of a kind, or None where the filter does not take it."""
        if kind not in self.kinds:
            return None
        k = self.kinds.index(kind)
        return slice(self.first[k], self.first[k] + self.count[k])

    def spread(self, per_kind: Tensor) -> Tensor:
        """Return values per kind repeated for each row.

        Args:
            per_kind: Shape (..., known).

        Returns:
            Shape (..., r).
        """
        return per_kind.index_select(-1, _owner(self, per_kind.device))


@lru_cache(maxsize=64)
def _owner(rows: Rows, device: torch.device) -> Tensor:
    owner = [int(kind) for kind, n in zip(rows.kinds, rows.count, strict=True) for _ in range(n)]
    # kept for later runs too, which may want gradients: never an inference tensor
    with torch.inference_mode(False):
        return torch.tensor(owner, dtype=torch.int64, device=device)


def measurement_rows(options: EkfOptions) -> Rows:
    """Return the rows that a filter's measurements take.

    Velocity has a vertical row only where fixes tell it and something vertical can answer for it:
    a pitch bias or a velocity state.

    Args:
        options: Choices of the filter.

    Returns:
        Rows.
    """
    answers = options.has_pitch_state or options.has_velocity_states
    vertical = options.vertical_velocity and answers
    gyro = len(options.gyro_states) > 0
    wanted = (
        (Kind.POSITION, options.position, 3),
        (Kind.VELOCITY, options.velocity, 3 if vertical else 2),
        (Kind.COURSE, options.course, 1),
        (Kind.ZERO_YAW_RATE, options.zero_yaw_rate and gyro, 1),
        (Kind.ZERO_SPEED, options.zero_speed and options.has_velocity_states, 3),
    )
    return rows_of(wanted, len(Kind))


def rows_of(wanted: Sequence[tuple[IntEnum, bool, int]], known: int) -> Rows:
    """Return rows laid one kind after another.

    Args:
        wanted: Per kind: the kind, whether it is used, its number of rows.
        known: Number of kinds that the family of filters knows.

    Returns:
        Rows of the kinds that are used.
    """
    used = [(kind, n) for kind, use, n in wanted if use]
    count = tuple(n for _, n in used)
    first = tuple(sum(count[:k]) for k in range(len(count)))
    return Rows(tuple(kind for kind, _ in used), first, count, known)
