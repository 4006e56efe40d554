"""What is said about a run whose gate refuses much, or whose innovations are far too large."""

import warnings
from collections.abc import Mapping
from enum import IntEnum

import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.fusion.gating import Gated
from navlearn.fusion.measurements import Kind, Verdict, refused

WARN_REFUSED = 0.5
"""Share of refused measurements of one kind above which a run is warned about."""

WARN_AT_LEAST = 30
"""Fewest measurements of a kind on which a warning is based."""

WARN_NIS = 5.0
"""Median NIS over that of χ² above which a run is warned about.

Too small an NIS is no ill health: noise-free simulation and sensors better than stated have one.
"""


# texts without figures: Python tells the same text once, however many stretches are replayed
def warn_of_refusals(model: Gated, verdicts: Tensor) -> None:
    """Warn where the gate refuses most measurements of a kind.

    Args:
        model: The filter's rows.
        verdicts: Codes of :class:`navlearn.fusion.measurements.Verdict`, shape (..., kinds).
    """
    for kind in model.rows.kinds:
        verdict = verdicts[..., kind]
        seen = int((verdict != int(Verdict.ABSENT)).sum())
        out = int(refused(verdict).sum())
        if seen >= WARN_AT_LEAST and out > WARN_REFUSED * seen:
            limited = model.gate.tests_position and kind == Kind.POSITION
            small = "the noise or a limit in metres" if limited else "the noise"
            warnings.warn(
                f"filter: the gate refused more than {WARN_REFUSED:.0%} of the measurements of "
                f"kind {kind.name.lower()}; {small} is too small for this log, or azimuth, "
                "odometer scale or lever arm are wrong: look at history.nis",
                UserWarning,
                stacklevel=4,
            )


def warn_of_noise(
    model: Gated, squares: Tensor, advice: Mapping[IntEnum, str], options: str
) -> None:
    """Warn where innovations are far larger than their noise foretells.

    Args:
        model: The filter's rows.
        squares: NIS, NaN where nothing is measured, shape (..., kinds).
        advice: Noise to change, per kind.
        options: Class of options that it belongs to.
    """
    for kind, degrees in zip(model.rows.kinds, model.rows.count, strict=True):
        nis = squares[..., kind].detach()
        nis = nis[torch.isfinite(nis)]
        if len(nis) < WARN_AT_LEAST:
            continue
        # the median, so that a few outliers that the gate refuses do not count
        if float(nis.median()) > WARN_NIS * chi_square_quantile(0.5, degrees):
            warnings.warn(
                f"filter: half of the innovations of kind {kind.name.lower()} have an NIS above "
                f"{WARN_NIS:g} times what their noise foretells; raise {advice[kind]} in {options}",
                UserWarning,
                stacklevel=4,
            )
