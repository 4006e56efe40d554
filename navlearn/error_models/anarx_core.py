"""Mathematics of the additive NARX network, in standardised units.

Source: [Petlenkov2006] for the additive form and its state space, [Jaradat2017] Eqs. (14)-(15)
for its use on navigation errors, with the lags written as

    y(t+1) = sum_{i=1..n} f_i(y(t-i+1), u(t-i+1)) + c,   f_i(z) = V_i act(W_i z + b_i) + L_i z.

Row k of a record holds u(t) beside y(t+1): ``u[k]`` describes the interval that ends when
``y[k]`` is valid, as everywhere in navlearn. One hidden layer per lag makes the state small:

    x_j(t+1) = x_{j+1}(t) + f_j(y(t), u(t)),   x_{n+1} = 0,   y = x_1 + c.

Here ``state[..., 0, :]`` is the last output itself and ``state[..., j, :]`` with j >= 1 the
partial sum that will be completed j steps later.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class AnarxWeights(NamedTuple):
    """Weights of all lags; n lags, h hidden units, p outputs, q = p + inputs.

    Attributes:
        weight: Hidden weights W on [y, u], shape (n, h, q).
        bias: Hidden biases b, shape (n, h).
        out: Output weights V, shape (n, p, h).
        linear: Direct linear path L on [y, u], shape (n, p, q); zeros where there is none.
        offset: Constant c, shape (p,).
    """

    weight: Tensor
    bias: Tensor
    out: Tensor
    linear: Tensor
    offset: Tensor


def activate(z: Tensor, sigmoid: bool) -> Tensor:
    """Return the logistic sigmoid or the hyperbolic tangent of ``z``."""
    if sigmoid:
        return torch.sigmoid(z)
    return torch.tanh(z)


def lag_outputs(w: AnarxWeights, sigmoid: bool, y: Tensor, u: Tensor) -> Tensor:
    """Return f_i(y, u) of every lag.

    Args:
        w: Weights.
        sigmoid: Activation, as in ``activate``.
        y: Output that is fed back, shape (..., p).
        u: Inputs, shape (..., m).

    Returns:
        Shape (..., n, p).
    """
    n, h, q = w.weight.shape
    z = torch.cat([y, u], -1)
    pre = torch.nn.functional.linear(z, w.weight.view(n * h, q), w.bias.view(n * h))
    hidden = torch.unflatten(activate(pre, sigmoid), -1, [n, 1, h])
    direct = torch.nn.functional.linear(z, w.linear.view(-1, q))
    return (hidden * w.out).sum(-1) + torch.unflatten(direct, -1, [n, -1])


def advance(
    w: AnarxWeights, sigmoid: bool, limit: float, state: Tensor, u: Tensor
) -> tuple[Tensor, Tensor]:
    """Return output and state after one step.

    Args:
        w: Weights.
        sigmoid: Activation.
        limit: Largest magnitude that an output may take (infinite: none).
        state: Shape (..., n, p).
        u: Inputs of this step, shape (..., m).

    Returns:
        Output of shape (..., p) and the next state.
    """
    f = lag_outputs(w, sigmoid, state[..., 0, :], u)
    sums = f + torch.nn.functional.pad(state[..., 1:, :], [0, 0, 0, 1])
    y = torch.clamp(sums[..., 0, :] + w.offset, -limit, limit)
    return y, torch.cat([y.unsqueeze(-2), sums[..., 1:, :]], -2)


def held_state(w: AnarxWeights, sigmoid: bool, y: Tensor, u: Tensor) -> Tensor:
    """Return the state of a network that has seen ``y`` and ``u`` for ever.

    Args:
        w: Weights.
        sigmoid: Activation.
        y: Output before the first step, shape (..., p).
        u: Inputs of the first step, shape (..., m).

    Returns:
        Shape (..., n, p).
    """
    f = lag_outputs(w, sigmoid, y, u)
    sums = f.flip(-2).cumsum(-2).flip(-2)
    return torch.cat([y.unsqueeze(-2), sums[..., 1:, :]], -2)


def forced_state(w: AnarxWeights, sigmoid: bool, before: Tensor, u: Tensor, y: Tensor) -> Tensor:
    """Return the state after rows whose outputs were measured.

    Args:
        w: Weights.
        sigmoid: Activation.
        before: Measured output before each of the last n − 1 rows, shape (..., n − 1, p).
        u: Inputs of these rows, shape (..., n − 1, m).
        y: Output measured last, shape (..., p).

    Returns:
        Shape (..., n, p).
    """
    n = w.weight.shape[0]
    f = lag_outputs(w, sigmoid, before, u)
    sums = [y]
    for j in range(1, n):
        total = f[..., n - 2, j, :]
        for i in range(j + 1, n):
            total = total + f[..., n - 2 - (i - j), i, :]
        sums.append(total)
    return torch.stack(sums, -2)


def held_rows(u: Tensor, y: Tensor, y_start: Tensor, lags: int) -> tuple[Tensor, Tensor]:
    """Lengthen a record to the front as if its first values had always been there.

    Args:
        u: Inputs, shape (..., T, m).
        y: Outputs as measured, shape (..., T, p).
        y_start: Output before the first row, shape (..., p).
        lags: Number of lags n.

    Returns:
        The output that precedes each row and the inputs of each row, shape (..., T + n − 1, ·).
    """
    first = y_start.unsqueeze(-2)
    before = torch.cat([first] * lags + [y[..., :-1, :]], -2)
    inputs = torch.cat([u[..., :1, :]] * (lags - 1) + [u], -2)
    return before, inputs


def one_step_ahead(w: AnarxWeights, sigmoid: bool, before: Tensor, u: Tensor) -> Tensor:
    """Predict every row from measured outputs, in parallel over time.

    Args:
        w: Weights.
        sigmoid: Activation.
        before: Measured output before each row, shape (..., T + n − 1, p), from ``held_rows``.
        u: Inputs of each row, shape (..., T + n − 1, m).

    Returns:
        Shape (..., T, p).
    """
    n = w.weight.shape[0]
    f = lag_outputs(w, sigmoid, before, u)
    rows = f.shape[-3] - n + 1
    total = w.offset
    for i in range(n):
        total = total + f[..., n - 1 - i : n - 1 - i + rows, i, :]
    return total


def free_run(
    w: AnarxWeights, sigmoid: bool, limit: float, u: Tensor, state: Tensor
) -> tuple[Tensor, Tensor]:
    """Run on the network's own output; the same as ``advance`` over time, to rounding.

    What the inputs add to every hidden unit is computed for all times at once; the loop holds
    only what feeds back.

    Args:
        w: Weights.
        sigmoid: Activation.
        limit: Largest magnitude that an output may take (infinite: none).
        u: Inputs, shape (N, T, m).
        state: Shape (N, n, p).

    Returns:
        Outputs of shape (N, T, p) and the state after the last row.
    """
    n, h, q = w.weight.shape
    p = w.offset.shape[0]
    # One product per step: the output weights of all lags as one block-diagonal matrix.
    out = torch.zeros([n, h, n, p], dtype=u.dtype, device=u.device)
    for i in range(n):
        out[i, :, i] = w.out[i].t()
    out = out.view(n * h, n * p)
    hidden_y = w.weight[:, :, :p].reshape(n * h, p).t()
    direct_y = w.linear[:, :, :p].reshape(n * p, p).t()
    hidden_u = torch.nn.functional.linear(
        u.transpose(0, 1), w.weight[:, :, p:].reshape(n * h, q - p), w.bias.reshape(n * h)
    )
    offset = torch.nn.functional.pad(w.offset, [0, n * p - p])
    direct_u = torch.nn.functional.linear(
        u.transpose(0, 1), w.linear[:, :, p:].reshape(n * p, q - p), offset
    )
    # In time order, as lists: indexing a tensor in a loop has a quadratic backward.
    hidden_rows, direct_rows = hidden_u.unbind(0), direct_u.unbind(0)
    y = state[:, 0]
    sums = state.flatten(1)
    outputs: list[Tensor] = []
    for k in range(len(hidden_rows)):
        hidden = activate(torch.addmm(hidden_rows[k], y, hidden_y), sigmoid)
        f = torch.addmm(torch.addmm(direct_rows[k], hidden, out), y, direct_y)
        sums = f + torch.nn.functional.pad(sums[:, p:], [0, p])
        y = torch.clamp(sums[:, :p], -limit, limit)
        outputs.append(y)
    final = torch.cat([y.unsqueeze(1), sums.view(-1, n, p)[:, 1:]], 1)
    return torch.stack(outputs, 1), final
