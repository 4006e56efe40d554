"""Causal low-pass filters over time: one sample at a time, and all samples at once.

A cascade of equal first-order sections, each the exact response to an input that is constant over
every interval: y_k = y_{k−1} + (1 − e^{−dt/τ})(x_k − y_{k−1}).
"""

import torch
from torch import Tensor


def low_pass_step(stages: Tensor, value: Tensor, dt: Tensor, time_constant: float) -> Tensor:
    """Return the outputs of all sections after one more input.

    Args:
        stages: Outputs of the sections before, shape (..., n).
        value: Mean input over the interval, shape (...).
        dt: Length of the interval, s, shape (...); zero changes nothing.
        time_constant: τ of each section, s; zero passes the input on.

    Returns:
        Outputs of the sections, shape (..., n); the last is that of the cascade.
    """
    keep = _kept(dt, time_constant)
    outputs: list[Tensor] = []
    for before in torch.unbind(stages, -1):
        value = value + keep * (before - value)
        outputs.append(value)
    return torch.stack(outputs, -1)


def low_pass_over_time(values: Tensor, dt: Tensor, time_constant: float, sections: int) -> Tensor:
    """Return the output of the cascade for all samples, started at rest on the first.

    Prefix composition by doubling: log2(T) sweeps, safe for any gap between samples.

    Args:
        values: Mean inputs over intervals, shape (..., T).
        dt: Length of the intervals, s, shape (..., T); zero holds the output.
        time_constant: τ of each section, s; zero passes the input on.
        sections: Number of sections.

    Returns:
        Output, shape (..., T).
    """
    keep = _kept(dt, time_constant)
    for _ in range(sections):
        values = _recur(keep, values)
    return values


def _kept(dt: Tensor, time_constant: float) -> Tensor:
    if time_constant > 0.0:
        return torch.exp(-dt / time_constant)
    return (dt <= 0.0).to(dt.dtype)


def _recur(keep: Tensor, values: Tensor) -> Tensor:
    """Solve y_k = keep_k y_{k−1} + (1 − keep_k) values_k with y_0 = values_0."""
    output = torch.cat((values[..., :1], ((1.0 - keep) * values)[..., 1:]), -1)
    reach = 1
    while reach < values.shape[-1]:
        # each entry composes with the one that ends where it begins
        output = torch.cat(
            (output[..., :reach], output[..., reach:] + keep[..., reach:] * output[..., :-reach]),
            -1,
        )
        keep = torch.cat((keep[..., :reach], keep[..., reach:] * keep[..., :-reach]), -1)
        reach *= 2
    return output
