"""When FOS takes a term for real: by what the best of many candidates reaches on white noise.

[Shen2010] leaves the stopping rule open. ``paper`` puts on a term the threshold that [Iqbal2020]
put on a cascade, 4 over the number of rows: right for one candidate named beforehand, far too
low for the best of hundreds.
"""

import math
from functools import lru_cache
from statistics import NormalDist

from navlearn.error_models.fos_options import FosOptions


@lru_cache(maxsize=4096)
def noise_level(rows: float, terms: int, candidates: int, false_alarm: float) -> float:
    """Return the share of white noise that the best of many candidates takes by chance.

    A share ρ² that one candidate takes of ν + 1 degrees of freedom is t²/(ν + t²) with Student's
    t; its quantile is from the normal one by [Wallace1959], the many by Šidák's bound.

    Args:
        rows: Rows that count; with weights, their effective number.
        terms: Terms chosen already.
        candidates: Candidates left.
        false_alarm: Chance that the best exceeds the level.

    Returns:
        A share of the residual's energy, in 0 to 1.
    """
    freedom = rows - terms - 1.0
    if false_alarm >= 1.0:
        return 0.0
    if freedom <= 1.0 or candidates < 1:
        return 1.0
    single = -math.expm1(math.log1p(-false_alarm) / candidates)
    z = -NormalDist().inv_cdf(0.5 * single)
    z *= (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
    return -math.expm1(-z * z / freedom)


def accepted_share(rows: float, terms: int, candidates: int, options: FosOptions) -> float:
    """Return the share of the residual's energy that a term must take.

    Args:
        rows: Rows that count; with weights, their effective number.
        terms: Terms chosen already.
        candidates: Candidates left.
        options: Rule.
    """
    if options.acceptance == "paper":
        return min(4.0 / rows, 1.0)
    return noise_level(rows, terms, candidates, options.false_alarm)
