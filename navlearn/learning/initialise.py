"""Where training starts: random hidden layers, output layers by linear least squares.

Hidden weights are drawn by Nguyen and Widrow's rule [Nguyen1990], which spreads the active
regions of the units over the range of the inputs. Given them the network is linear in all its
other weights, and those are solved for. A start without feedback from the output is stable in
closed loop by construction.
"""

import torch
from torch import Tensor

from navlearn.error_models.anarx_core import AnarxWeights
from navlearn.error_models.anarx_jacobian import pack_weights
from navlearn.learning.anarx_least_squares import AnarxLeastSquares

# Standardised channels mostly lie within two standard deviations.
INPUT_REACH = 2.0
# Share of the mean diagonal that keeps the linear solve positive.
SOLVE_RIDGE = 1e-6


def nguyen_widrow(
    like: AnarxWeights, sigmoid: bool, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw hidden weights (n, h, q) and biases (n, h).

    Args:
        like: Weights that give the shapes.
        sigmoid: True for the logistic sigmoid, which needs twice the slope of the tanh.
        generator: Source of randomness.
    """
    n, h, q = like.weight.shape
    reach = 0.7 * h ** (1.0 / q) * (2.0 if sigmoid else 1.0)
    direction = torch.randn(n, h, q, generator=generator, dtype=torch.float64)
    direction = direction / direction.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    shift = 2.0 * torch.rand(n, h, generator=generator, dtype=torch.float64) - 1.0
    return direction * (reach / INPUT_REACH), shift * reach


def random_start(
    problem: AnarxLeastSquares,
    generator: torch.Generator,
    *,
    feedback: bool,
    ridge: float = 0.0,
) -> Tensor:
    """Return packed weights: hidden layers drawn, everything linear solved for.

    Args:
        problem: Problem whose targets are to be met; in closed loop only without feedback.
        generator: Source of randomness.
        feedback: False sets all weights on the fed-back output to zero.
        ridge: Weight of ½ |θ|² beside the data in that solve, as in training.

    Returns:
        θ, shape (P,).
    """
    like, linear_path = problem.like, problem.linear_path
    weight, bias = nguyen_widrow(like, problem.sigmoid, generator)
    p = like.offset.shape[0]
    solve_linear = torch.ones_like(like.linear)
    if not feedback:
        weight[:, :, :p] = 0.0
        solve_linear[:, :, :p] = 0.0
    blank = AnarxWeights(
        weight,
        bias,
        torch.zeros_like(like.out),
        torch.zeros_like(like.linear),
        torch.zeros_like(like.offset),
    )
    solved = AnarxWeights(
        torch.zeros_like(weight),
        torch.zeros_like(bias),
        torch.ones_like(like.out),
        solve_linear,
        torch.ones_like(like.offset),
    )
    theta = pack_weights(blank, linear_path)
    free = pack_weights(solved, linear_path) > 0
    data = problem.normal_equations(theta)
    gram = data.gram[free][:, free]
    gram.diagonal().add_(ridge + SOLVE_RIDGE * float(gram.diagonal().mean()) + 1e-300)
    theta[free] = -torch.linalg.solve(gram, data.gradient[free])
    return theta
