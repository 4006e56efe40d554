"""Terms of a gyro-rate error from parallel cascades [Iqbal2020, IV; Korenberg1991].

A gyro answers at once, so the linear element of a cascade is a direction among channels at one
moment, without memory. Cascades are found on the gyro's error per block, smoothed from both
sides; a cascade's powers are then terms like any other, integrated and fitted by the ridge.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.error_models.gyro_terms import GyroTerms
from navlearn.error_models.pci_fit import fit_pci
from navlearn.error_models.pci_options import PciOptions
from navlearn.filters.scan import LinearSteps, filter_in_parallel
from navlearn.filters.smoother import forward_pass, smooth_in_parallel
from navlearn.learning.azimuth_regression import AzimuthCurve, AzimuthNoise


def smoothed_rate_error(
    curve: AzimuthCurve, noise: AzimuthNoise, walk: float
) -> tuple[Tensor, Tensor]:
    """Return the gyro's whole error at the ends of blocks, from the fixes around each.

    Args:
        curve: The azimuth error of the raw gyro.
        noise: What it holds beside the rate error.
        walk: How fast the rate error may change, rad/s/√s.

    Returns:
        Rate error (rad/s) and its variance, shape (K,) each.
    """
    tau, change = curve.moving, walk**2 * curve.duration
    one, zero = torch.ones_like(tau), torch.zeros_like(tau)
    transition = _matrix(one, -tau, zero, one)
    q = noise.gyro_random_walk**2 * tau + noise.turn_noise**2 * curve.turning
    cross = -0.5 * tau * change
    told, rests = torch.isfinite(curve.error), curve.rest > 0.0
    seen = torch.stack(((told & ~rests).double(), rests.double()), -1).unsqueeze(-2)
    at_rest = noise.rest**2 / curve.rest.clamp(min=1e-9)
    variance = torch.where(rests, at_rest, torch.where(told, curve.variance, 1.0))
    value = torch.where(rests, curve.rest_rate, torch.where(told, curve.error, 0.0))
    steps = LinearSteps(
        transition=transition,
        shift=torch.stack((zero, zero), -1),
        noise=_matrix(q + tau * tau * change / 3.0, cross, cross, change),
        observation=seen,
        variance=variance.unsqueeze(-1),
        measurement=value.unsqueeze(-1),
    )
    mean = torch.zeros(2, dtype=torch.float64)
    spread = torch.diag(torch.tensor([10.0, noise.gyro_bias], dtype=torch.float64) ** 2)
    forward = forward_pass(mean, spread, steps, filter_in_parallel(mean, spread, steps))
    smoothed = smooth_in_parallel(forward)
    return smoothed.mean[1:, 1], smoothed.covariance[1:, 1, 1]


def cascade_terms(
    channels: Tensor, target: Tensor, weight: Tensor, options: PciOptions
) -> GyroTerms:
    """Return the powers of the cascades that explain a rate error; there may be none.

    Args:
        channels: Channels by block, shape (K, m).
        target: Rate error, rad/s, shape (K,).
        weight: Weight of each block, shape (K,).
        options: Rules of the search; without lags.
    """
    fitted = fit_pci(channels, target, options, weight)
    model: Any = fitted.model
    weights = model.response[:, 0, :] / model.u_scale
    constant = -(weights * model.u_mean).sum(-1, keepdim=True)
    form = torch.cat((constant, weights), -1)
    names, forms = [], []
    unit = torch.zeros_like(form[:1]).squeeze(0) if len(form) else channels.new_zeros(0)
    for k, linear in enumerate(form):
        for power in range(1, options.degree + 1):
            one = unit.clone()
            one[0] = 1.0
            names.append(f"cascade_{k + 1}" + (f"^{power}" if power > 1 else ""))
            forms.append(torch.stack([linear] * power + [one] * (options.degree - power)))
    shape = (len(forms), options.degree, channels.shape[-1] + 1)
    stacked = torch.stack(forms) if forms else channels.new_zeros(shape)
    return GyroTerms(tuple(names), stacked, torch.zeros_like(stacked[..., 0]))


def _matrix(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
    return torch.stack((a, b, c, d), -1).reshape(*a.shape, 2, 2)
