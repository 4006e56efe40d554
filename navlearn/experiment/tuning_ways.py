"""The ways to tune a recipe's filter, and what each tells of what it found."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import timeline_of
from navlearn.experiment.tuning_drives import laid_out
from navlearn.fusion.options import EkfOptions
from navlearn.learning.allan_start import tuned_by_allan
from navlearn.learning.difference_tuning import Rule, tuned_by_differences
from navlearn.learning.noise_figures import NoiseFigures
from navlearn.learning.noise_options import TuningOptions
from navlearn.learning.noise_parameters import INITIAL
from navlearn.learning.noise_tuning import TunedNoise, tune_noise
from navlearn.learning.referenced_drive import referenced_drive
from navlearn.learning.tuned_values import TunedValues
from navlearn.logs.drive_log import DriveLog
from navlearn.recipe import Recipe

TuningMethod = Literal["gradient", "differences", "ghouneem2024", "allan"]

METHODS: tuple[TuningMethod, ...] = ("gradient", "differences", "ghouneem2024", "allan")
"""Ways to tune, by name."""


@dataclass
class FoundNoise:
    """What a way to tune found."""

    filter: dict[str, Any]
    numbers: dict[str, Any]
    notes: list[str]
    figures: NoiseFigures | None = None


def by_gradient(
    recipe: Recipe,
    logs: Sequence[DriveLog],
    before: EkfOptions,
    tuning: TuningOptions,
    checkpoint: Path,
    progress: bool,
) -> FoundNoise:
    """Return the noise of largest innovation likelihood.

    Args:
        recipe: Tells rate and dimensions.
        logs: What to tune on.
        before: The filter to begin with.
        tuning: How to search.
        checkpoint: Folder in which an interrupted search is kept, and gone on from.
        progress: Whether to show a progress bar.

    Raises:
        ConfigError: The checkpoint is of another search, or the filter cannot be tuned.
        LogError: A drive cannot be used.
        FilterDivergedError: The filter is lost.
    """
    found = tune_noise(
        [laid_out(log, recipe).drive for log in logs],
        before,
        tuning,
        folder=checkpoint,
        resume=True,
        progress=progress,
    )
    return FoundNoise(_overrides(found), _numbers(found), _notes(found), found.figures)


def _overrides(found: TunedNoise) -> dict[str, Any]:
    """Return the entries that were free as overrides of a filter's options."""
    noise: dict[str, Any] = {}
    initial: dict[str, Any] = {}
    for name, value in found.values.items():
        rounded = float(f"{value:.4g}")
        group, _, term = name.removeprefix(INITIAL).partition(".")
        if not name.startswith(INITIAL):
            noise[name] = rounded
        elif term:
            initial.setdefault(group, {})[term] = rounded
        else:
            initial[group] = rounded
    groups = {"noise": noise, "initial": initial}
    return {name: group for name, group in groups.items() if group}


def _numbers(found: TunedNoise) -> dict[str, Any]:
    entries = found.figures.entries
    return {
        "tuned_on_s": round(found.seconds, 1),
        "gain_nats": round(found.gain, 2),
        "steps": found.iterations,
        "converged": int(found.converged),
        "standard_error_of_logarithm": {
            one.name: round(one.error, 3) for one in found.figures.entries
        },
        **_of_fixes(found),
        "curvature_nats": {one.name: round(one.curvature, 2) for one in entries},
    }


def _of_fixes(found: TunedNoise) -> dict[str, Any]:
    return {
        f"deviation_of_{one.name}".replace(", ", "_").replace(" ", "_"): {
            "before": float(f"{one.before:.4g}"),
            "after": float(f"{one.after:.4g}"),
            "standard_error_of_logarithm": round(one.error, 3),
        }
        for one in found.figures.fixes
    }


def _notes(found: TunedNoise) -> list[str]:
    notes = ["noise of largest innovation likelihood; no reference was used"]
    vague = [one.name for one in found.figures.entries if not one.told]
    if vague:
        notes.append(f"the drives could not tell {', '.join(vague)}: the prior holds them")
    if found.gain <= 0.0:
        notes.append("no gain: by the filter's own gate the drives are no likelier than before")
    if not found.converged:
        notes.append("the search was stopped before it ended by itself")
    return notes


def by_rule(
    recipe: Recipe, logs: Sequence[DriveLog], before: EkfOptions, method: TuningMethod
) -> FoundNoise:
    """Return the noise that a rule tells.

    Args:
        recipe: Tells rate and dimensions.
        logs: What to tune on; ``allan`` reads the first.
        before: The filter whose noise it is to be.
        method: ``differences``, ``ghouneem2024`` or ``allan``.

    Raises:
        LogError: A drive cannot be used.
        FitError: The rule finds no noise.
    """
    if method == "allan":
        found = tuned_by_allan(logs[0])
    else:
        found = _by_differences(recipe, logs, before, method)
    return FoundNoise(found.filter, dict(found.figures), list(found.notes))


def _by_differences(
    recipe: Recipe, logs: Sequence[DriveLog], before: EkfOptions, method: TuningMethod
) -> TunedValues:
    drives = [
        referenced_drive(log, timeline_of(log, recipe), filter_options(recipe, log=log).lever_arm)
        for log in logs
    ]
    # negative averages are no variances: without their signs there is a filter to look at
    rule: Rule = "increments" if method == "differences" else "ghouneem2024_absolute"
    return tuned_by_differences(drives, before, rule)
