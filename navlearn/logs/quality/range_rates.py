"""Whether range rates are the rates of the pseudoranges: sign, unit, noise."""

import numpy as np
import torch

from navlearn.logs.quality.findings import Part
from navlearn.logs.single_point_fixes import ReceptionSolutions

_LONGEST = 5.0
"""Receptions farther apart than this are not differenced, s."""

_KNOWN = {
    -1.0: "the sign is turned: a Doppler shift is positive where the range shrinks",
    -5.2550: "it is a Doppler shift in Hz: multiply by minus the wavelength (0.1903 m on L1)",
    5.2550: "it is in Hz: multiply by the wavelength (0.1903 m on L1)",
}


def check_range_rates(part: Part, found: ReceptionSolutions) -> None:
    """Compare range rates with differenced pseudoranges, the receiver clock taken off both.

    Args:
        part: What the checks found, added to.
        found: Solutions of all receptions.
    """
    ranges = found.series.ranges
    if not bool((ranges.has_rate > 0.0).any()):
        part.not_observable["range_rate_scale"] = "the ranges have no range rate"
        return
    dt = torch.diff(found.series.t).unsqueeze(-1)
    told = (ranges.has_rate > 0.0) & (ranges.has_range > 0.0)
    both = told[1:] & told[:-1] & (dt < _LONGEST)
    both &= (both.sum(-1, keepdim=True) >= 3).expand_as(both)
    if int(both.sum()) < 30:
        part.not_observable["range_rate_scale"] = "too few satellites from reception to reception"
        return
    change = _beside_the_others(torch.diff(ranges.pseudorange, dim=0) / dt, both)
    mean = _beside_the_others(0.5 * (ranges.range_rate[1:] + ranges.range_rate[:-1]), both)
    x, y = change[both].numpy(), mean[both].numpy()
    scale = _scale(x, y)
    part.figures["range_rate_scale"] = scale
    residual = np.abs(y - scale * x)
    median = float(np.median(residual))
    part.figures["range_rate_residual_median_m_per_s"] = median
    _judge(part, scale, median, float(np.median(np.abs(x))))


def _beside_the_others(values: torch.Tensor, both: torch.Tensor) -> torch.Tensor:
    middle = torch.where(both, values, torch.nan).nanmedian(dim=-1, keepdim=True).values
    return values - middle


def _scale(x: np.ndarray, y: np.ndarray) -> float:
    """Return the slope of y over x, what lies far off left out."""
    kept = np.ones(len(x), dtype=np.bool_)
    slope = 0.0
    for _ in range(3):
        slope = float(x[kept] @ y[kept]) / max(float(x[kept] @ x[kept]), 1e-9)
        off = np.abs(y - slope * x)
        kept = off <= max(5.0 * float(np.median(off)), 1e-6)
    return slope


def _judge(part: Part, scale: float, residual: float, size: float) -> None:
    expected = "the rate of the pseudorange, positive where it grows, scale 1"
    found = f"range_rate reports {scale:.4g} of the rate of the pseudoranges"
    if abs(scale - 1.0) > 0.03:
        remedy = next(
            (text for value, text in _KNOWN.items() if abs(scale / value - 1.0) < 0.05),
            "check its unit and its satellite's clock rate, or leave range_rate out",
        )
        part.add("error", "range rate", "ranges range_rate", found, expected, remedy)
    elif residual > max(2.0, 0.02 * size):
        part.add(
            "warning",
            "range rate",
            "ranges range_rate",
            f"{found}, {residual:.2f} m/s off (median)",
            "decimetres per second and the noise of the code",
            "check that both are of one signal and one time",
        )
