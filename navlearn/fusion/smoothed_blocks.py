"""What smoothing has in common for all families of filters: evidence, one pass, and its repetition.

Deviations from what blocks predict from their guessed starts are a linear system; it is filtered
and smoothed over all blocks in parallel. Passes about what was smoothed before are Gauss–Newton on
the whole drive [Bell1994].
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from navlearn.filters.belief import Belief
from navlearn.filters.ins_belief import InsBelief
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.filters.smoother import Smoothed, forward_pass, smooth_in_parallel
from navlearn.fusion.gated_pass import Linearised
from navlearn.fusion.gating import Gated, taken
from navlearn.fusion.record import starts_of_blocks

AnyBelief = TypeVar("AnyBelief", Belief, InsBelief)
Line = TypeVar("Line")
Noise = TypeVar("Noise")


@dataclass(frozen=True, kw_only=True)
class SmoothingOptions:
    """How a drive is smoothed.

    Attributes:
        passes: Most passes; 1 is the classical smoother about the filter's beliefs.
        tolerance: Largest move of a block's start in the last pass, m; azimuth counts as 30 m
            ahead of the car.
        give_up: Where the last pass still moves a start further than this, m, the passes do not
            converge, and the classical smoother's result is returned.
    """

    passes: int = 10
    tolerance: float = 1e-3
    give_up: float = 0.1


class Evidence(NamedTuple, Generic[AnyBelief, Line, Noise]):
    """What all passes over a drive share.

    Attributes:
        start: Belief before the first sample, batch shape (B,).
        line: The drives in blocks.
        noise: Noise densities and deviations.
        verdict: The filter's verdicts, which are kept, shape (B, K, kinds).
        opened: Variance that the gate's resets added at the ends of blocks, shape (B, K, n).
        weight: How much the filter let each kind count, shape (B, K, kinds), which is kept; None
            where its gate does not weigh.
    """

    start: AnyBelief
    line: Line
    noise: Noise
    verdict: Tensor
    opened: Tensor
    weight: Tensor | None = None


class SmoothedPass(NamedTuple, Generic[AnyBelief]):
    """What a pass gives.

    Attributes:
        start: Smoothed belief before the first sample, batch shape (B,).
        belief: Smoothed belief at the end of each block, batch shape (B, K).
        transition: Φ of each block at the guess, shape (B, K, n, n).
        gain: Smoother gain from each block's end to its start, shape (B, K, n, n).
    """

    start: AnyBelief
    belief: AnyBelief
    transition: Tensor
    gain: Tensor


def smoothed_deviations(
    model: Gated,
    prior: Tensor,
    covariance: Tensor,
    blocks: Linearised,
    verdict: Tensor,
    opened: Tensor,
    weight: Tensor | None = None,
) -> Smoothed:
    """Filter and smooth deviations from linearised blocks.

    Args:
        model: The filter's gate and rows.
        prior: Belief before the first sample minus its guess, shape (B, n).
        covariance: Its covariance, shape (B, n, n).
        blocks: The blocks, linearised at a guess.
        verdict: Which measurements are taken, shape (B, K, kinds).
        opened: Variance that resets add at the ends of blocks, shape (B, K, n).
        weight: How much each kind counts, shape (B, K, kinds); None as its variance says.

    Returns:
        Deviations from the first guess, then from the blocks' ends, with covariances and gains.
    """
    used = taken(model, blocks.found, verdict, weight)
    steps = LinearSteps(
        blocks.transition,
        blocks.shift,
        blocks.noise + torch.diag_embed(opened),
        used.observation,
        used.variance,
        used.innovation,
    )
    filtered = filter_in_parallel(prior, covariance, steps)
    return smooth_in_parallel(forward_pass(prior, covariance, steps, filtered))


def iterated(
    begin: AnyBelief,
    run: Callable[[AnyBelief], SmoothedPass[AnyBelief]],
    move: Callable[[AnyBelief, AnyBelief], float],
    options: SmoothingOptions,
) -> tuple[SmoothedPass[AnyBelief], int]:
    """Repeat passes about what was smoothed before.

    Args:
        begin: First guess of the beliefs at which blocks start, batch shape (B, K).
        run: One pass from such a guess.
        move: How far the worst start moved from one guess to the next, m.
        options: How many passes, and how near is enough.

    Returns:
        The last pass, or the first where the passes do not converge, and their number.
    """
    first = found = run(begin)
    moved = 0.0
    for number in range(2, options.passes + 1):
        begin = starts_of_blocks(found.start, found.belief)
        found = run(begin)
        moved = move(starts_of_blocks(found.start, found.belief), begin)
        if moved < options.tolerance:
            return found, number
    # written so that NaN, which is not below anything, gives up too
    return (found, options.passes) if moved < options.give_up else (first, 1)
