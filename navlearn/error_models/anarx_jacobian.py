"""Analytic Jacobians of the additive NARX network with respect to its weights.

One step ahead, the additive form keeps the weights of a lag in columns of their own, so the
Jacobian is filled block by block without a sum. In closed loop the outputs feed back, and the
full recurrent Jacobian follows by forward sensitivity,

    S(t+1) = G(t+1) + sum_i A_i(t-i+1) S(t-i+1),   A_i = df_i/dy,

where G is the one-step Jacobian at the outputs that the network itself produced.
"""

import torch
from torch import Tensor

from navlearn.error_models.anarx_core import AnarxWeights, activate


def pack_weights(w: AnarxWeights, linear_path: bool) -> Tensor:
    """Return the weights as one vector θ: the weights of lag after lag, the offset last.

    Args:
        w: Weights.
        linear_path: False leaves the linear terms out.
    """
    n = w.weight.shape[0]
    parts = [w.weight, w.bias, w.out] + ([w.linear] if linear_path else [])
    by_lag = torch.cat([part.reshape(n, -1) for part in parts], 1)
    return torch.cat([by_lag.reshape(-1), w.offset])


def unpack_weights(theta: Tensor, like: AnarxWeights, linear_path: bool) -> AnarxWeights:
    """Return the weights that ``pack_weights`` packed, with the shapes of another set."""
    n, p = like.weight.shape[0], like.offset.shape[0]
    parts = [like.weight, like.bias, like.out] + ([like.linear] if linear_path else [])
    sizes = [part.numel() // n for part in parts]
    pieces = torch.split_with_sizes(theta[: theta.shape[0] - p].reshape(n, -1), sizes, 1)
    shaped = [
        piece.reshape(part.shape).contiguous() for piece, part in zip(pieces, parts, strict=True)
    ]
    linear = shaped[3] if linear_path else torch.zeros_like(like.linear)
    return AnarxWeights(shaped[0], shaped[1], shaped[2], linear, theta[theta.shape[0] - p :])


def _hidden(w: AnarxWeights, sigmoid: bool, z: Tensor) -> tuple[Tensor, Tensor]:
    """Return activations and their slopes, shape (..., n, h) each, at z of shape (..., q)."""
    n, h, q = w.weight.shape
    pre = torch.nn.functional.linear(z, w.weight.reshape(n * h, q), w.bias.reshape(n * h))
    active = torch.unflatten(activate(pre, sigmoid), -1, (n, h))
    return active, active * (1.0 - active) if sigmoid else 1.0 - active**2


def one_step_jacobian(
    w: AnarxWeights, sigmoid: bool, linear_path: bool, before: Tensor, u: Tensor
) -> Tensor:
    """Return d(one-step prediction)/dθ of every row.

    Args:
        w: Weights.
        sigmoid: Activation.
        linear_path: True where θ holds the linear terms.
        before: Output before each row, shape (N, T + n − 1, p).
        u: Inputs of each row, shape (N, T + n − 1, m).

    Returns:
        Shape (N, T, p, P).
    """
    n, h, q = w.weight.shape
    p = w.offset.shape[0]
    z = torch.cat([before, u], -1)
    active, slope = _hidden(w, sigmoid, z)
    count, rows = z.shape[0], z.shape[1] - n + 1
    per_lag = h * q + h + p * h + (p * q if linear_path else 0)
    jacobian = z.new_zeros(count, rows, p, n * per_lag + p)
    for i in range(n):
        at = slice(n - 1 - i, n - 1 - i + rows)
        z_i, a_i = z[:, at], active[:, at, i]
        g = slope[:, at, i].unsqueeze(2) * w.out[i]
        block = jacobian[..., i * per_lag : (i + 1) * per_lag]
        hidden = torch.unflatten(block[..., : h * q], -1, (h, q))
        torch.mul(g.unsqueeze(-1), z_i[:, :, None, None], out=hidden)
        block[..., h * q : h * q + h] = g
        for j in range(p):
            first = h * q + h + j * h
            block[:, :, j, first : first + h] = a_i
            if linear_path:
                first = h * q + h + p * h + j * q
                block[:, :, j, first : first + q] = z_i
    jacobian[..., n * per_lag :] = torch.eye(p, dtype=z.dtype)
    return jacobian


def feedback_jacobian(w: AnarxWeights, sigmoid: bool, before: Tensor, u: Tensor) -> Tensor:
    """Return A_i = df_i/dy of every row and lag, shape (..., n, p, p).

    Args:
        w: Weights.
        sigmoid: Activation.
        before: Output before each row, shape (..., p).
        u: Inputs of each row, shape (..., m).
    """
    p = w.offset.shape[0]
    _, slope = _hidden(w, sigmoid, torch.cat([before, u], -1))
    gain = slope.unsqueeze(-2) * w.out
    return torch.matmul(gain, w.weight[:, :, :p]) + w.linear[:, :, :p]


def closed_loop_jacobian(
    w: AnarxWeights, sigmoid: bool, linear_path: bool, before: Tensor, u: Tensor
) -> Tensor:
    """Return d(free run)/dθ of every row, the start held fixed.

    Args:
        w: Weights.
        sigmoid: Activation.
        linear_path: True where θ holds the linear terms.
        before: Output before each row, shape (N, T + n − 1, p): n values that were given, then
            the network's own outputs.
        u: Inputs of each row, shape (N, T + n − 1, m).

    Returns:
        Shape (N, T, p, P).
    """
    n, p = w.weight.shape[0], w.offset.shape[0]
    sensitivity = one_step_jacobian(w, sigmoid, linear_path, before, u)
    feedback = feedback_jacobian(w, sigmoid, before, u)
    count, rows = sensitivity.shape[:2]
    # Lag i of row k was formed at padded row k + n - 1 - i, from the output of row k - 1 - i:
    # oldest first, to lie beside the sensitivities in time order.
    gains = torch.cat(
        [feedback[:, n - 1 - i : n - 1 - i + rows, i] for i in reversed(range(n))], -1
    )
    for k in range(1, rows):
        past = min(n, k)
        history = sensitivity[:, k - past : k].reshape(count, past * p, -1)
        sensitivity[:, k].baddbmm_(gains[:, k, :, (n - past) * p :], history)
    return sensitivity
