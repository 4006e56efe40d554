"""Levenberg–Marquardt for any least-squares problem that can form its normal equations.

Minimises ½ Σ w r² + ½ ridge |θ|². The damping follows the gain ratio by Nielsen's rule,
[Madsen2004] Algorithm 3.16: it shrinks smoothly after a good step and grows ever faster while
steps fail.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from navlearn.errors import ConfigError, FitError


class NormalEquations(NamedTuple):
    """A least-squares problem linearised at one point.

    Attributes:
        cost: ½ Σ w r², a number.
        gram: J^T W J, shape (P, P).
        gradient: J^T W r, shape (P,).
    """

    cost: float
    gram: Tensor
    gradient: Tensor


class LeastSquares(Protocol):
    """A problem in P parameters."""

    def cost(self, theta: Tensor) -> float:
        """Return ½ Σ w r² at θ, shape (P,); infinite or NaN where the model diverges."""
        ...

    def normal_equations(self, theta: Tensor) -> NormalEquations:
        """Return cost, gram and gradient at θ."""
        ...


@dataclass(frozen=True, kw_only=True)
class LmOptions:
    """Settings of the algorithm.

    Attributes:
        max_iterations: Linearisations at the most.
        ridge: Weight of ½ |θ|² beside the data.
        initial_damping: First damping as a share of the largest diagonal entry of the gram.
        gradient_tolerance: Stop where the largest gradient entry is below it, relative to cost.
        step_tolerance: Stop where a step is shorter than this share of |θ|.
        cost_tolerance: Stop after three accepted steps that each gain less than this share.
    """

    max_iterations: int = 100
    ridge: float = 0.0
    initial_damping: float = 1e-3
    gradient_tolerance: float = 1e-12
    step_tolerance: float = 1e-10
    cost_tolerance: float = 1e-9

    def __post_init__(self) -> None:
        if self.max_iterations < 0 or self.ridge < 0.0 or not self.initial_damping > 0.0:
            raise ConfigError(
                f"levenberg_marquardt: max_iterations {self.max_iterations} and ridge "
                f"{self.ridge} must not be negative, initial_damping {self.initial_damping} "
                "must be positive"
            )


class LmState(NamedTuple):
    """Where the algorithm stands; enough to go on from.

    Attributes:
        theta: Parameters, shape (P,).
        damping: Present damping; negative before the first linearisation.
        growth: What the damping is multiplied by at the next failure.
        iteration: Linearisations made.
        cost: Cost with ridge at ``theta``.
        small_gains: Accepted steps in a row that gained next to nothing.
        stopped: Why it ended, or an empty string.
    """

    theta: Tensor
    damping: float
    growth: float
    iteration: int
    cost: float
    small_gains: int
    stopped: str


def start_state(theta: Tensor) -> LmState:
    """Return the state before the first iteration."""
    return LmState(theta.detach().clone().double(), -1.0, 2.0, 0, float("inf"), 0, "")


def iterate(problem: LeastSquares, state: LmState, options: LmOptions) -> LmState:
    """Linearise once and take one accepted step, raising the damping until one is found.

    Args:
        problem: What to minimise.
        state: Where it stands.
        options: Settings.

    Raises:
        FitError: The cost at the starting point is not finite.
    """
    theta, damping, growth = state.theta, state.damping, state.growth
    data = problem.normal_equations(theta)
    cost = data.cost + 0.5 * options.ridge * float(theta @ theta)
    if not cost < float("inf"):
        raise FitError(
            f"levenberg_marquardt: the cost at iteration {state.iteration} is {cost}; start from "
            "weights with which the model does not diverge"
        )
    gram = data.gram.clone()
    gram.diagonal().add_(options.ridge)
    gradient = data.gradient + options.ridge * theta
    if damping < 0.0:
        damping = options.initial_damping * float(gram.diagonal().amax().clamp(min=1e-300))
    iteration = state.iteration + 1
    if float(gradient.abs().amax()) <= options.gradient_tolerance * max(cost, 1e-300):
        return LmState(theta, damping, growth, iteration, cost, 0, "gradient")
    while True:
        step = _damped_step(gram, gradient, damping)
        if step is not None:
            if float(step.norm()) <= options.step_tolerance * (float(theta.norm()) + 1e-12):
                return LmState(theta, damping, growth, iteration, cost, 0, "step")
            trial = theta + step
            new_cost = problem.cost(trial) + 0.5 * options.ridge * float(trial @ trial)
            promised = 0.5 * float(step @ (damping * step - gradient))
            gain = (cost - new_cost) / promised if promised > 0.0 else -1.0
            if new_cost < cost and gain > 0.0:
                damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                small = state.small_gains + 1
                small = small if cost - new_cost <= options.cost_tolerance * cost else 0
                stopped = "cost" if small >= 3 else ""
                return LmState(trial, damping, 2.0, iteration, new_cost, small, stopped)
        damping, growth = damping * growth, growth * 2.0
        if not damping < 1e300:
            return LmState(theta, damping, growth, iteration, cost, 0, "damping")


def _damped_step(gram: Tensor, gradient: Tensor, damping: float) -> Tensor | None:
    """Return −(G + μI)⁻¹ g, or None where rounding left no positive matrix."""
    damped = gram.clone()
    damped.diagonal().add_(damping)
    factor, info = torch.linalg.cholesky_ex(damped)
    if int(info) != 0:
        return None
    return -torch.cholesky_solve(gradient.unsqueeze(-1), factor).squeeze(-1)


def levenberg_marquardt(
    problem: LeastSquares,
    start: Tensor | LmState,
    options: LmOptions,
    callback: Callable[[LmState], bool] | None = None,
) -> LmState:
    """Minimise a least-squares problem.

    Args:
        problem: What to minimise.
        start: Parameters of shape (P,), or a state to go on from.
        options: Settings.
        callback: Called after every iteration; returning True ends the search.

    Returns:
        The last state; its ``stopped`` says why it ended: ``gradient``, ``step``, ``cost``,
        ``damping``, ``callback`` or ``iterations``.

    Raises:
        FitError: The cost at the starting point is not finite.
    """
    state = start if isinstance(start, LmState) else start_state(start)
    while not state.stopped and state.iteration < options.max_iterations:
        state = iterate(problem, state, options)
        if callback is not None and callback(state) and not state.stopped:
            state = state._replace(stopped="callback")
    return state if state.stopped else state._replace(stopped="iterations")
