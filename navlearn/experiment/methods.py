"""The one place where a method is plugged in.

A method that needs no spec gets a builder in ``FIXED`` and a line in
:data:`navlearn.recipe.fixed_methods.FIXED_METHODS`; one that learns gets a spec class in
:mod:`navlearn.recipe.spec` and a builder in ``LEARNED``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from navlearn.experiment.anarx_method import AnarxMethod
from navlearn.experiment.augmented_method import AugmentedMethod
from navlearn.experiment.azimuth_method import AzimuthMethod
from navlearn.experiment.baselines import PLAIN, DeadReckoning, FilterMethod, FilterRuns
from navlearn.experiment.ins_anarx_diagnostics import Diagnose
from navlearn.experiment.ins_anarx_method import InsAnarxMethod
from navlearn.experiment.ins_anarx_paper import PaperAnarxMethod
from navlearn.experiment.ins_filter_runs import VARIANTS, InsFilterRuns
from navlearn.experiment.ins_methods import InsDeadReckoning, InsFilterMethod, InsSmoothed
from navlearn.experiment.learned import Learned
from navlearn.experiment.oracles import GyroOracle, PerfectAzimuth, Truth
from navlearn.experiment.pseudo_outage_method import PseudoOutageMethod
from navlearn.experiment.range_error_method import RangeErrorMethod
from navlearn.experiment.rts_method import SmoothedFilter
from navlearn.experiment.tight_filter_runs import TIGHT, TightFilterRuns
from navlearn.experiment.tight_method import TightMethod
from navlearn.outages.replay import Method
from navlearn.recipe import Recipe
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.recipe.ingredients import INGREDIENTS
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.pseudo_outage_spec import PseudoOutageSpec
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.recipe.spec_base import SpecBase

Keep = Callable[[str, Learned], None]


@dataclass(frozen=True, kw_only=True)
class MethodContext:
    """What methods are built from.

    Attributes:
        recipe: The recipe.
        runs: Filter runs, shared by all methods.
        ins_runs: Runs of the full-IMU filter, likewise.
        tight_runs: Runs of the tightly coupled filter, likewise.
        keep: Called with the name of each model and every fit of it that can be stored.
        truth: What no method can know; for oracles alone.
        diagnose: Called with the name of each model of a full IMU and the diagnostics of each of
            its fits.
    """

    recipe: Recipe
    runs: FilterRuns
    ins_runs: InsFilterRuns
    tight_runs: TightFilterRuns
    keep: Keep | None = None
    truth: Truth | None = None
    diagnose: Diagnose | None = None


def _full_imu(context: MethodContext) -> bool:
    return context.recipe.mechanization.sensors == "imu"


def _dead_reckoning(context: MethodContext) -> Method:
    recipe = context.recipe
    return InsDeadReckoning(recipe) if _full_imu(context) else DeadReckoning(recipe)


def _smoothed(context: MethodContext) -> Method:
    return InsSmoothed(context.ins_runs) if _full_imu(context) else SmoothedFilter(context.runs)


def _ins_filter(name: str) -> Callable[[MethodContext], Method]:
    return lambda context: InsFilterMethod(context.ins_runs, name)


def _riss_filter(name: str) -> Callable[[MethodContext], Method]:
    return lambda context: FilterMethod(context.runs, name)


def _tight_filter(name: str) -> Callable[[MethodContext], Method]:
    return lambda context: TightMethod(context.tight_runs, name)


RISS: Final = ("ekf", *PLAIN, *(name for name in INGREDIENTS if name.startswith(("ekf", "ukf"))))
"""Loosely coupled filters of one gyro, by name."""

FIXED: Final[dict[str, Callable[[MethodContext], Method]]] = {
    "dead_reckoning": _dead_reckoning,
    **{name: _riss_filter(name) for name in RISS},
    **{name: _ins_filter(name) for name in VARIANTS},
    **{name: _tight_filter(name) for name in TIGHT},
    "rts": _smoothed,
    "oracle": lambda context: GyroOracle(context.runs, context.truth, noise_free=False),
    "noise_free_gyro": lambda context: GyroOracle(context.runs, context.truth, noise_free=True),
    "perfect_azimuth": lambda context: PerfectAzimuth(context.runs, context.truth),
}
"""Builders of the methods that need no spec."""


def _ins_anarx(context: MethodContext, spec: InsAnarxSpec) -> Method:
    if spec.mode == "paper":
        return PaperAnarxMethod(context.ins_runs, spec, context.diagnose)
    return InsAnarxMethod(context.ins_runs, spec, context.keep, context.diagnose)


LEARNED: Final[dict[type[SpecBase], Callable[[MethodContext, Any], Method]]] = {
    AugmentedSpec: lambda context, spec: AugmentedMethod(context.runs, spec),
    AnarxSpec: lambda context, spec: AnarxMethod(context.runs, spec, context.keep),
    PseudoOutageSpec: lambda context, spec: PseudoOutageMethod(context.runs, spec, context.keep),
    AzimuthSpec: lambda context, spec: AzimuthMethod(context.runs, spec, context.keep),
    InsAnarxSpec: _ins_anarx,
    RangeErrorSpec: lambda context, spec: RangeErrorMethod(context.tight_runs, spec, context.keep),
}
"""Builders of the methods that learn, by the class of their spec."""


def build_methods(
    recipe: Recipe,
    keep: Keep | None = None,
    truth: Truth | None = None,
    runs: FilterRuns | None = None,
    diagnose: Diagnose | None = None,
) -> dict[str, Method]:
    """Return the methods that a recipe compares, in its order.

    Args:
        recipe: The recipe.
        keep: Called with the name of each model and every fit of it that can be stored.
        truth: What no method can know; for oracles alone.
        runs: Filter runs to share; None makes them anew.
        diagnose: Called with the diagnostics of each fit of a full IMU's models.
    """
    shared = FilterRuns(recipe) if runs is None else runs
    context = MethodContext(
        recipe=recipe,
        runs=shared,
        ins_runs=InsFilterRuns(recipe),
        tight_runs=TightFilterRuns(recipe),
        keep=keep,
        truth=truth,
        diagnose=diagnose,
    )
    return {name: _built(name, context) for name in recipe.methods}


def _built(name: str, context: MethodContext) -> Method:
    if name in FIXED:
        return FIXED[name](context)
    spec = context.recipe.model(name)
    return LEARNED[type(spec)](context, spec)
