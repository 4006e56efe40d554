"""What a run tells its report: the drive, the methods, and what was estimated from what."""

import json
import math
import shlex
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from navlearn.experiment.drive import Drive
from navlearn.experiment.learned import SHARES
from navlearn.outages.replay import Replay
from navlearn.outages.run_summary import DriveSummary, MethodSummary, RunSummary
from navlearn.outages.track import driven, track_of
from navlearn.recipe import Recipe
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.recipe.fixed_methods import FIXED_METHODS
from navlearn.recipe.spec_base import SpecBase
from navlearn.recipe.tuned_spec import TunedSpec


def run_summary(
    recipe: Recipe, drive: Drive, found: Replay, versions: Mapping[str, str], folder: Path
) -> RunSummary:
    """Return everything that the report of a run tells.

    Args:
        recipe: The recipe.
        drive: Its drive.
        found: What came of its outages.
        versions: Of navlearn and what it stands on.
        folder: The run's folder.
    """
    return RunSummary(
        title=recipe.name,
        question=recipe.question,
        drives=(_drive_summary(drive),),
        protocol=recipe.outages.protocol(),
        methods={
            name: MethodSummary(**FIXED_METHODS[name]._asdict())
            if name in FIXED_METHODS
            else _learned_summary(recipe.model(name), found)
            for name in recipe.methods
        },
        rows=found.rows,
        command=f"navlearn run {shlex.quote(str(folder / 'recipe.yaml'))} --out NEW_FOLDER",
        versions=versions,
        seeds=_seeds(recipe),
        baselines=recipe.baselines[:2],
        metric=recipe.metric,
        remarks=(*recipe.remarks, *_semi_synthetic(drive)),
        published=tuple(one.table() for one in recipe.published),
        setup=_setup(recipe, drive),
    )


def _semi_synthetic(drive: Drive) -> tuple[str, ...]:
    stated = drive.log.metadata.extra.get("semi_synthetic")
    if not isinstance(stated, Mapping):
        return ()
    return (
        f"Semi-synthetic: to the drive's own gyro an error of grade `{stated['grade']}` (seed "
        f"{stated['seed']}) was added.",
    )


def _seeds(recipe: Recipe) -> dict[str, int]:
    seeds = {"recipe": recipe.seed}
    for spec in recipe.models:
        seeds |= spec.seeds
    return seeds


def _drive_summary(drive: Drive) -> DriveSummary:
    log = drive.log
    truth = "truth" if log.metadata.is_truth else "reference"
    return DriveSummary(
        name=log.metadata.name,
        source=log.metadata.source,
        duration=log.duration,
        distance=float(driven(track_of(log))[-1]),
        placement=drive.placement,
        license=log.metadata.license,
        judged_by="fixes" if log.reference is None else truth,
    )


def _setup(recipe: Recipe, drive: Drive) -> tuple[str, ...]:
    told = filter_and_training(recipe)
    return (*told[:2], *drive.notes, *told[2:])


def filter_and_training(recipe: Recipe) -> tuple[str, ...]:
    """Return how a recipe mechanizes, filters and trains, a sentence each.

    Args:
        recipe: The recipe.
    """
    mechanization, training = recipe.mechanization, recipe.training
    stated = sorted({**recipe.filter, **recipe.filter.get("noise", {})}.keys() - {"noise"})
    told = f"but for {', '.join(stated)}, which the recipe states" if stated else "throughout"
    lines = [
        f"mechanization: {mechanization.dims}D, {mechanization.rate_hz:g} Hz",
        f"filter: the package's defaults {told}; the same for every method but "
        "for what models and oracles change of it",
    ]
    anarx = [spec for spec in recipe.models if isinstance(spec, AnarxSpec)]
    if any(spec.trained is None for spec in anarx):
        past = "whole past" if training.window_s is None else f"last {training.window_s:g} s"
        lines.append(
            f"training of ANARX: for each outage anew on its drive's {past}, on outages of "
            f"{training.horizon_s:g} s emulated every {training.restart_every_s:g} s, in steps of "
            f"{training.step_s:g} s: the first {SHARES[0]:.0%} of the time to fit, up to "
            f"{SHARES[1]:.0%} to stop by, the rest for the gate; what passes is fitted once more "
            "on all of it"
        )
    return tuple(lines)


def _ingredients(recipe: Recipe) -> tuple[str, ...]:
    """Return what the sections of ingredients say, a sentence each."""
    lines = [
        f"{section}: {json.dumps(options)} in place of the defaults, for the methods that take it"
        for section, options in (
            ("sigma points", recipe.unscented),
            ("integrity", recipe.integrity),
        )
        if options
    ]
    lines += [tuned_with(spec) for spec in recipe.tunings if spec is not None]
    return tuple(lines)


def tuned_with(spec: TunedSpec) -> str:
    """Return what was tuned, how and on what, as a sentence.

    Args:
        spec: The tuned spec.
    """
    where = ", ".join(one.log for one in spec.made_from) or "what its maker does not tell"
    return f"tuned: `{spec.name}` by {spec.method} on {where}: {json.dumps(spec.filter)}"


def _learned_summary(spec: SpecBase, found: Replay) -> MethodSummary:
    mine = [one.notes for (name, _), one in found.solutions.items() if name == spec.name]
    used = sum(bool(notes.get("used")) for notes in mine)
    gains = [
        float(str(notes["gate_improvement_percent"]))
        for notes in mine
        if "gate_improvement_percent" in notes
    ]
    known = [gain for gain in gains if math.isfinite(gain)]
    why = "the gate let it act" if spec.safeguard.gate else "without a gate it acted"
    notes = [f"{why} in {used} of {len(mine)} outages"]
    if known:
        middle = float(pd.Series(known).median())
        notes.append(f"median improvement on the gate's emulated outages {middle:+.1f} %")
    unfitted = {str(one["reason"]) for one in mine if not one.get("fitted", "gate_replays" in one)}
    notes += [f"could not be fitted: {reason}" for reason in sorted(unfitted)]
    return MethodSummary(
        description=spec.describe(),
        regime=spec.regime,
        notes=tuple(notes),
        guarded=spec.safeguard.gate,
    )
