"""From continuous error dynamics to steps of a discrete filter: noise, transition, composition."""

import torch
from torch import Tensor

from navlearn.filters.ekf import symmetrized


def density_of(omega_ib_b: Tensor, white: Tensor, walks: Tensor) -> Tensor:
    """Return the diagonal of the spectral density of the noise that drives the errors; scriptable.

    White noise of three like axes has no direction, so the attitude does not matter.

    Args:
        omega_ib_b: Angular rate, rad/s, shape (..., 3).
        white: Angle random walk (rad/√s), velocity random walk (m/s/√s) and turn noise (√s),
            shape (3,).
        walks: Random walk of each sensor parameter, its unit per √s, shape (m,).

    Returns:
        Density per error state, its unit squared per second, shape (..., 9 + m).
    """
    gyro_walk, accel_walk, turn_noise = white.unbind(0)
    turn = (omega_ib_b * omega_ib_b).sum(-1, keepdim=True)
    one = torch.ones_like(omega_ib_b)
    gyro = one * (gyro_walk**2 + turn_noise**2 * turn)
    accel = accel_walk**2 * one
    return torch.cat((torch.zeros_like(one), accel, gyro, one[..., :1] * walks**2), -1)


def discretized(dynamics: Tensor, density: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
    """Return transition and process noise of a short interval; scriptable.

    The exponential to second order and Q = ½ (Φ Qc Φᵀ + Qc) Δt, which differ from Van Loan's by
    the third order of F Δt. [Groves2013] Eq. (3.23), (3.46).

    Args:
        dynamics: F, 1/s, shape (..., n, n).
        density: Diagonal of Qc, shape (..., n).
        dt: Length of the interval, s, shape (...).

    Returns:
        Φ and Q, shape (..., n, n) each.
    """
    step = dynamics * dt.unsqueeze(-1).unsqueeze(-1)
    eye = torch.eye(step.shape[-1], dtype=step.dtype, device=step.device)
    transition = eye + step + 0.5 * (step @ step)
    half = torch.diag_embed(0.5 * density * dt.unsqueeze(-1))
    return transition, half + transition @ half @ transition.transpose(-1, -2)


def composed(transition: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Return transition and noise of a sequence of linear steps, composed pair by pair.

    Args:
        transition: Φ of each step, shape (..., n, N, N).
        noise: Q of each step, shape (..., n, N, N).

    Returns:
        Φ and Q of all of them, shape (..., N, N) each.
    """
    while transition.shape[-3] > 1:
        odd = transition.shape[-3] % 2
        first, second = transition[..., odd::2, :, :], transition[..., odd + 1 :: 2, :, :]
        q_1, q_2 = noise[..., odd::2, :, :], noise[..., odd + 1 :: 2, :, :]
        joined = second @ first
        q = symmetrized(second @ q_1 @ second.transpose(-1, -2) + q_2)
        if odd:
            joined = torch.cat((transition[..., :1, :, :], joined), -3)
            q = torch.cat((noise[..., :1, :, :], q), -3)
        transition, noise = joined, q
    return transition.squeeze(-3), noise.squeeze(-3)
