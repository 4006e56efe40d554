"""Passes over all blocks until their starts no longer move.

The states with which all blocks start are the unknowns; a pass turns a guess of them into a better
one. Gradients: converge without, then two passes with; the first of them carries what the data do
to the states, the second also what the states do to the linearisation.
"""

from typing import Any, Protocol, TypeVar

import torch

AnyBelief = TypeVar("AnyBelief")
Record = TypeVar("Record")
Said = TypeVar("Said", covariant=True)

MOST_PASSES = 20
"""Passes after which the fast form gives up."""

EARLY = 3
"""Passes that may still be far from the solution; a later one that moves far was told to by the
verdicts, and forgetting them would only bring back the pass before."""


class Gate(Protocol[Said]):
    """What a gate said within a pass.

    Attributes:
        said: What it believes now, for the next pass to use.
        reproduced: Whether that is what the pass had used.
    """

    @property
    def said(self) -> Said: ...  # noqa: D102

    @property
    def reproduced(self) -> bool: ...  # noqa: D102


class Passes(Protocol[AnyBelief, Record]):
    """Passes over the same blocks."""

    @property
    def tolerances(self) -> tuple[float, float]:
        """Largest moves of a block's start, m, before passes with gradients and in the last."""
        ...

    def run(self, guess: AnyBelief, verdict: Any, rounds: int) -> tuple[Record, Gate[Any]]:
        """Run one pass from a guess, the gate's verdicts to use, and how often to renew them.

        Verdicts of None leave the pass to its own first ones.
        """
        ...

    def starts(self, record: Record) -> AnyBelief:
        """Return where blocks start by what a pass found, batch shape (B, K)."""
        ...

    def move(self, new: AnyBelief, old: AnyBelief) -> float:
        """Return how far the worst block's start moved, m."""
        ...

    def trusts(self, new: AnyBelief, old: AnyBelief) -> bool:
        """Return whether an early pass moved little enough for the gate's verdicts to hold."""
        ...

    def detached(self, begin: AnyBelief) -> AnyBelief:
        """Return the same beliefs without gradients."""
        ...


def solved(
    begin: AnyBelief,
    passes: Passes[AnyBelief, Record],
    learning: bool,
    differentiable: int = 2,
) -> tuple[Record, int] | None:
    """Run passes until they change nothing.

    Args:
        begin: First guess of the beliefs at which blocks start, batch shape (B, K).
        passes: The passes.
        learning: Whether the record shall carry gradients.
        differentiable: How many passes then carry them.

    Returns:
        The last pass's record and the number of passes, or None where they did not converge or
        the gate's verdicts oscillate.
    """
    total, last = 0, passes.tolerances[1]
    for tolerance in passes.tolerances if learning else (last,):
        with torch.no_grad():
            found = _converged(begin, passes, tolerance)
        if found is None:
            return None
        record, behind, number = found
        total += number
        if not learning:
            return record, total
        verdict = behind.said
        for _ in range(differentiable):
            # the first block starts where the caller said: that carries its gradient
            begin = passes.starts(record)
            record, behind = passes.run(begin, verdict, 0)
        total += differentiable
        with torch.no_grad():
            new = passes.starts(record)
            if behind.reproduced and passes.move(new, begin) < last:
                return record, total
            begin = passes.detached(new)
    return None


def _converged(
    begin: AnyBelief, passes: Passes[AnyBelief, Record], tolerance: float
) -> tuple[Record, Gate[Any], int] | None:
    verdict: Any = None
    for number in range(1, MOST_PASSES + 1):
        record, behind = passes.run(begin, verdict, 1 if number <= 2 else 4)
        new = passes.starts(record)
        if behind.reproduced and passes.move(new, begin) < tolerance:
            return record, behind, number
        # what a first pass refuses may only be far from its guess; passes are asked every time,
        # because to be trusted is how they learn that they came near
        keep = passes.trusts(new, begin) or number > EARLY
        verdict, begin = behind.said if keep else None, new
    return None
