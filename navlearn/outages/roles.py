"""What part a method plays in a comparison: who competes, and who only marks a bound."""

from collections.abc import Iterable, Mapping
from typing import Final, Literal

from navlearn.outages.run_summary import MethodSummary

Role = Literal["baseline", "learned", "post-processing", "oracle"]

ORACLE: Final = "oracle"
"""Knows the deterministic sensor errors: what a model of them could reach at best."""

BOUND: Final = "noise_free_gyro"
"""Has no gyro error left at all; a real-time method better than that is not to be believed."""

ORACLES: Final = (ORACLE, BOUND, "perfect_azimuth")
"""Methods that know what no car can know."""

PAPERS: Final = ("iqbal2020", "shen2010", "jaradat2017")
"""How the names of methods begin that work as a paper printed them."""

BASELINE_VERDICTS: Final = {"helps": "better", "harms": "worse", "harmless": "no worse"}
"""What is said of methods that do not learn: nothing of them acts, so nothing helps or harms."""


def role_of(name: str, regime: str = "none") -> Role:
    """Return what part a method plays.

    Args:
        name: Its name.
        regime: Its training regime.
    """
    if name in ORACLES or regime == "oracle":
        return "oracle"
    if regime == "post-processing":
        return "post-processing"
    return "baseline" if regime == "none" else "learned"


def roles(methods: Mapping[str, MethodSummary]) -> dict[str, Role]:
    """Return what part each method plays, by name.

    Args:
        methods: The methods.
    """
    return {name: role_of(name, about.regime) for name, about in methods.items()}


def having(methods: Mapping[str, MethodSummary], *wanted: Role) -> list[str]:
    """Return the methods that play one of some parts, in their order.

    Args:
        methods: The methods.
        wanted: The parts.
    """
    return [name for name, role in roles(methods).items() if role in wanted]


def real_time(methods: Mapping[str, MethodSummary]) -> list[str]:
    """Return the methods that a car could run while it drives: the competitors.

    Args:
        methods: The methods.
    """
    return having(methods, "baseline", "learned")


def from_paper(name: str) -> bool:
    """Return whether a method works as a paper printed it.

    Args:
        name: Its name.
    """
    return name.startswith(PAPERS)


def oracles_last(names: Iterable[str]) -> list[str]:
    """Return names of methods with the oracles behind all others.

    Args:
        names: In the order of a run.
    """
    return sorted(names, key=lambda name: name in ORACLES)


def verdict_words(verdict: str, role: Role, *, never_differs: bool = False) -> str:
    """Return what a table says of a method.

    Args:
        verdict: Its verdict against a baseline.
        role: The part it plays.
        never_differs: Whether it equals the baseline in every outage.
    """
    if role != "learned":
        return BASELINE_VERDICTS.get(verdict, verdict)
    if never_differs:
        return f"{verdict} (never acted)" if verdict == "harmless" else "never acted"
    return verdict
