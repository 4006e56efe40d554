"""From continuous error dynamics to one step of a discrete filter."""

import torch
from torch import Tensor


def van_loan(dynamics: Tensor, diffusion: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
    """Return transition matrix and process noise of a linear system over an interval.

    Van Loan 1978: one matrix exponential of [[−F, Qc], [0, Fᵀ]] dt; exact for constant F.

    Args:
        dynamics: F of ẋ = F x + w, 1/s, shape (..., n, n).
        diffusion: Spectral density Qc of w, units of x² per second, shape (..., n, n).
        dt: Length of the interval, s, shape (...).

    Returns:
        Transition Φ and covariance Q of the accumulated noise, shape (..., n, n) each.
    """
    n = dynamics.shape[-1]
    zero = torch.zeros_like(dynamics)
    top = torch.cat((-dynamics, diffusion), dim=-1)
    bottom = torch.cat((zero, dynamics.transpose(-1, -2)), dim=-1)
    block = torch.matrix_exp(torch.cat((top, bottom), dim=-2) * dt.unsqueeze(-1).unsqueeze(-1))
    transition = block[..., n:, n:].transpose(-1, -2)
    noise = transition @ block[..., :n, n:]
    return transition, 0.5 * (noise + noise.transpose(-1, -2))
