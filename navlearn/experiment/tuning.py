"""A recipe's filter tuned: by likelihood without a reference, or by a rule that needs one.

What comes out is a tuned spec that recipes name, with what it was made from, what it gains on
held-out data, and whether to take it.
"""

import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from navlearn.errors import ConfigError, OutputExistsError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.drive import timeline_of
from navlearn.experiment.tuning_drives import Stretch, laid_out
from navlearn.experiment.tuning_verdict import UNJUDGED, TuningVerdict, judged
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
from navlearn.recipe.tuned_spec import TunedSpec, write_tuned

TuningMethod = Literal["gradient", "differences", "ghouneem2024", "allan"]

METHODS: tuple[TuningMethod, ...] = ("gradient", "differences", "ghouneem2024", "allan")
"""Ways to tune, by name."""


@dataclass(frozen=True, kw_only=True)
class TuningResult:
    """What a tuning gave.

    Attributes:
        spec: The tuned spec.
        figures: What became of each free entry; None for rules, which tell no errors.
        held_out: What held-out data say of it; None where nothing was held out.
        wall: How long it took, judging included, s.
    """

    spec: TunedSpec
    figures: NoiseFigures | None
    held_out: TuningVerdict | None
    wall: float


@dataclass
class _Found:
    """What a way to tune found."""

    filter: dict[str, Any]
    numbers: dict[str, Any]
    notes: list[str]
    figures: NoiseFigures | None = None


def tune_recipe(
    recipe: Recipe,
    stretches: Sequence[Stretch],
    out: Path,
    *,
    method: TuningMethod = "gradient",
    tuning: TuningOptions | None = None,
    name: str | None = None,
    force: bool = False,
    progress: bool = True,
) -> TuningResult:
    """Tune a recipe's filter and write the spec.

    Args:
        recipe: Its ``filter`` and ``mechanization`` tell the filter to begin with.
        stretches: What may be tuned on, and what judges it
            (:mod:`navlearn.experiment.tuning_drives`).
        out: The spec's file; an interrupted search by gradient keeps a checkpoint beside it and
            goes on from there.
        method: ``gradient``; ``differences`` or ``ghouneem2024``, which need a reference; or
            ``allan``, which needs a standstill.
        tuning: Choices of the search by gradient; None means the defaults.
        name: The spec's name; None for that of the file.
        force: Whether a file that is there may be replaced.
        progress: Whether to show a progress bar.

    Raises:
        ConfigError: The method is unknown, or nothing is left to tune on.
        OutputExistsError: The file is there.
        LogError: A drive cannot be used.
        FitError: A rule finds no noise.
        FilterDivergedError: The filter is lost.
    """
    begun = time.monotonic()
    refuse_overwriting(out, force)
    if method not in METHODS:
        raise ConfigError(f"method: found {method!r}; choose among {', '.join(METHODS)}")
    parts = [(stretch, stretch.tuning) for stretch in stretches]
    logs = [part for _, part in parts if part is not None]
    if not logs:
        raise ConfigError("tuning: every drive is held out; name more, or hold out a smaller share")
    if method == "allan" and len(logs) > 1:
        raise ConfigError(
            f"tuning: allan reads one standstill of one drive, and {len(logs)} are there to tune "
            "on; name one, and one to judge it by"
        )
    tuning = tuning or TuningOptions()
    before = filter_options(recipe, log=logs[0])
    checkpoint = out.with_name(f"{out.name}.unfinished")
    if method == "gradient":
        found = _by_gradient(recipe, logs, before, tuning, checkpoint, progress)
    else:
        found = _by_rule(recipe, logs, before, method)
    verdict = judged(recipe, stretches, before, found.filter, tuning)
    wall = time.monotonic() - begun
    spec = TunedSpec(
        name=name or _name_of(out),
        method=method,
        filter=found.filter,
        made_from=tuple(stretch.made_from for stretch, part in parts if part is not None),
        figures={
            **found.numbers,
            **({} if verdict is None else verdict.figures),
            "wall_s": round(wall, 1),
        },
        notes=(*found.notes, UNJUDGED if verdict is None else verdict.words),
    )
    write_tuned(out, spec, replace=force)
    shutil.rmtree(checkpoint, ignore_errors=True)
    return TuningResult(spec=spec, figures=found.figures, held_out=verdict, wall=wall)


def refuse_overwriting(out: Path, force: bool) -> None:
    """Refuse a file that cannot be written, before anything is read or tuned.

    Args:
        out: The spec's file.
        force: Whether it may be replaced.

    Raises:
        OutputExistsError: It is there, and may not be replaced; or a folder.
    """
    if out.is_dir():
        raise OutputExistsError(f"{out}: is a folder; name a file, such as tuned.yaml")
    if out.exists() and not force:
        raise OutputExistsError(f"{out}: exists; move it away, name another file, or force it")


def _name_of(out: Path) -> str:
    """Return a spec's name for a file, whatever characters the file's name has."""
    return re.sub(r"[^A-Za-z0-9_.+-]", "_", out.stem).lstrip("_.+-") or "tuned"


def _by_gradient(
    recipe: Recipe,
    logs: Sequence[DriveLog],
    before: EkfOptions,
    tuning: TuningOptions,
    checkpoint: Path,
    progress: bool,
) -> _Found:
    found = tune_noise(
        [laid_out(log, recipe).drive for log in logs],
        before,
        tuning,
        folder=checkpoint,
        resume=True,
        progress=progress,
    )
    return _Found(_overrides(found), _numbers(found), _notes(found), found.figures)


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


def _by_rule(
    recipe: Recipe, logs: Sequence[DriveLog], before: EkfOptions, method: TuningMethod
) -> _Found:
    if method == "allan":
        found = tuned_by_allan(logs[0])
    else:
        found = _by_differences(recipe, logs, before, method)
    return _Found(found.filter, dict(found.figures), list(found.notes))


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
