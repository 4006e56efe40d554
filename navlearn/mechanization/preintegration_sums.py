"""From sums over a window's samples to Jacobians and covariance of its increments.

The sums run over what is told of each sample, in this order: P 0:3, A 3:6, τ 6 and 1 at 7 (see
:mod:`navlearn.mechanization.preintegration_core`).
"""

import torch
from torch import Tensor

P, A, TAU, ONE = slice(0, 3), slice(3, 6), 6, 7


def by_rate(moments: Tensor) -> Tensor:
    """Return the derivative of the increments in what is taken off the rate.

    Args:
        moments: Sums of (P, A, τ, 1) times R dt, shape (N, 8, 3, 3).

    Returns:
        Rows position, velocity, rotation, shape (N, 9, 3).
    """
    position, velocity = crossed(moments[:, P]), crossed(moments[:, A])
    return torch.cat((position, velocity, -moments[:, ONE]), 1)


def by_force(moments: Tensor) -> Tensor:
    """Return the derivative of the increments in what is taken off the force.

    Args:
        moments: Sums of (P, A, τ, 1) times R dt, shape (N, 8, 3, 3).

    Returns:
        Rows position, velocity, rotation, shape (N, 9, 3).
    """
    one = moments[:, ONE]
    return torch.cat((-moments[:, TAU], -one, torch.zeros_like(one)), 1)


def crossed(moments: Tensor) -> Tensor:
    """Return Σ [A×] R of the sums of each component of A times R.

    Args:
        moments: Shape (N, 3, 3, 3), components of A first.

    Returns:
        Shape (N, 3, 3).
    """
    x, y, z = moments.unbind(1)
    rows = (y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0])
    return torch.stack(rows, 1)


def covariance_of(gram: Tensor, gyro: Tensor, accel: Tensor, duration: Tensor) -> Tensor:
    """Return the covariance of the increments by white noise, equal on all axes.

    Equal noise on three axes is the same in every frame, so rotations drop out of the sums.

    Args:
        gram: Sums of (P, A, τ, 1) times themselves times dt, shape (N, 8, 8).
        gyro: What the sums are to be multiplied with: the spectral density of the rate, rad²/s,
            or one where they hold it, shape (1, 1) or (N, 1).
        accel: Spectral density of the force, m²/s³, shape (1, 1) or (N, 1).
        duration: Length of the windows, s, shape (N, 1).

    Returns:
        Order position, velocity, rotation, shape (N, 9, 9).
    """
    eye = torch.eye(3, dtype=gram.dtype, device=gram.device)
    gram = gram * gyro.unsqueeze(-1)
    time = duration.unsqueeze(-1)
    # exact for white force, where sums over midpoints lack what happens within a sample
    force = accel.unsqueeze(-1) * eye
    pp = _double_cross(gram[:, P, P], eye) + force * (time**3 / 3.0)
    vv = _double_cross(gram[:, A, A], eye) + force * time
    pv = _double_cross(gram[:, A, P], eye) + force * (0.5 * time**2)
    p_turn, v_turn = -skew(gram[:, P, ONE]), -skew(gram[:, A, ONE])
    turn = gram[:, ONE, ONE].view(-1, 1, 1) * eye
    return torch.cat(
        (
            torch.cat((pp, pv, p_turn), -1),
            torch.cat((pv.transpose(-1, -2), vv, v_turn), -1),
            torch.cat((p_turn.transpose(-1, -2), v_turn.transpose(-1, -2), turn), -1),
        ),
        -2,
    )


def _double_cross(products: Tensor, eye: Tensor) -> Tensor:
    """Return Σ [P×] [A×]ᵀ = Σ (P·A) I − A Pᵀ of Σ A Pᵀ."""
    trace = products.diagonal(dim1=-2, dim2=-1).sum(-1)
    return trace.view(-1, 1, 1) * eye - products


def skew(vector: Tensor) -> Tensor:
    """Return [v×], the matrix of the cross product by a vector from the left; scriptable.

    Args:
        vector: Shape (..., 3).

    Returns:
        Shape (..., 3, 3).
    """
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    rows = (torch.stack((o, -z, y), -1), torch.stack((z, o, -x), -1), torch.stack((-y, x, o), -1))
    return torch.stack(rows, -2)
