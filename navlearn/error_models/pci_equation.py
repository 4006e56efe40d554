"""A fitted parallel cascade model in physical units, as numbers and as text that can be read."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.fos_equation import coefficient_unit
from navlearn.error_models.pci_candidates import Cascades
from navlearn.error_models.scaling import Scaling

EXPONENTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


class PhysicalCascades(NamedTuple):
    """K cascades y(n) = constant + Σ_k Σ_d power_kd v_k(n)^d, limits and clamps aside.

    v_k(n) = offset_k + Σ taps_k(j, i) x_i(n − j) has no unit and unit mean square in training.

    Attributes:
        constant: Unit of the output, shape ().
        taps: Per unit of each input, shape (K, R + 1, m).
        offset: Shape (K,).
        power: Coefficients of v to the 1 to D, unit of the output, shape (K, D).
        low: Smallest v in training, shape (K,).
        high: Largest v in training, shape (K,).
    """

    constant: Tensor
    taps: Tensor
    offset: Tensor
    power: Tensor
    low: Tensor
    high: Tensor


def physical_cascades(cascades: Cascades, inputs: Scaling, output: Scaling) -> PhysicalCascades:
    """Return cascades in physical units.

    Args:
        cascades: Responses of shape (K, R + 1, m), standardised units.
        inputs: Scaling of the inputs.
        output: Scaling of the output.
    """
    taps = cascades.response / inputs.scale
    power = output.scale * polynomial_powers(cascades.shift, cascades.norm, cascades.weight)
    return PhysicalCascades(
        constant=output.mean.squeeze(0) + power[:, 0].sum(),
        taps=taps,
        offset=-(taps * inputs.mean).sum((-1, -2)),
        power=power[:, 1:],
        low=cascades.low,
        high=cascades.high,
    )


def polynomial_powers(shift: Tensor, norm: Tensor, weight: Tensor) -> Tensor:
    """Return polynomials as coefficients of powers, from their orthonormal bases.

    Args:
        shift: α of the recurrence, shape (K, D).
        norm: β of the recurrence, shape (K, D).
        weight: Coefficients of the basis, shape (K, D + 1).

    Returns:
        Shape (K, D + 1).
    """
    count, degree = shift.shape
    before = torch.zeros(count, degree + 1, dtype=torch.float64)
    here = before.clone()
    here[:, 0] = 1.0
    total = weight[:, :1] * here
    for d in range(degree):
        ahead = here.roll(1, -1) - shift[:, d : d + 1] * here
        if d > 0:
            ahead = ahead - norm[:, d - 1 : d] * before
        before, here = here, ahead / norm[:, d : d + 1]
        total = total + weight[:, d + 1 : d + 2] * here
    return total


def shifted_powers(power: Tensor, offset: Tensor) -> Tensor:
    """Return the coefficients in w of polynomials in v = w + offset.

    Args:
        power: Coefficients of v, shape (K, D + 1).
        offset: Shape (K,).

    Returns:
        Shape (K, D + 1).
    """
    size = power.shape[1]
    shifted = torch.zeros_like(power)
    for d in range(size):
        for q in range(d + 1):
            shifted[:, q] += math.comb(d, q) * power[:, d] * offset ** (d - q)
    return shifted


def write_cascades(
    cascades: PhysicalCascades, names: tuple[str, ...], units: tuple[str, ...]
) -> str:
    """Return cascades as lines of text: their sum, then each polynomial and its response.

    Args:
        cascades: What to write.
        names: Names of the inputs, then of the output.
        units: Their units; empty to write none.
    """
    unit = units[-1] if units else ""
    count, degree = cascades.power.shape
    total = _term(float(cascades.constant), unit)
    lines = [" + ".join([f"{names[-1]}[k] = {total}", *(f"w{c + 1}[k]" for c in range(count))])]
    for c in range(count):
        v = f"v{c + 1}[k]"
        powers = [v, *(v + str(d).translate(EXPONENTS) for d in range(2, degree + 1))]
        parts = [_term(p, unit, x) for p, x in zip(cascades.power[c].tolist(), powers, strict=True)]
        lines.append(f"w{c + 1}[k] = {' '.join(parts)}")
        lines.append(f"{v} = {' '.join(_response(cascades, c, names, units))}")
        lines.append(f"    {float(cascades.low[c]):.3g} <= {v} <= {float(cascades.high[c]):.3g}")
    return "\n".join(lines)


def _response(
    cascades: PhysicalCascades, c: int, names: tuple[str, ...], units: tuple[str, ...]
) -> list[str]:
    """Return the parts of one linear response, without the channels that it does not read."""
    parts = [_term(float(cascades.offset[c]), "")]
    for lag, row in enumerate(cascades.taps[c].tolist()):
        for i, tap in enumerate(row):
            if tap == 0.0:
                continue
            moment = f"{names[i]}[k-{lag}]" if lag else f"{names[i]}[k]"
            parts.append(_term(tap, coefficient_unit("1", [units[i]]) if units else "", moment))
    return parts


def _term(value: float, unit: str, factor: str = "") -> str:
    """Return one summand."""
    number = f"{value:+.6g} {unit}".strip()
    return f"{number} · {factor}" if factor else number
