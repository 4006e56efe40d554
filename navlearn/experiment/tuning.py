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

from navlearn.errors import ConfigError, OutputExistsError
from navlearn.experiment.baselines import filter_options
from navlearn.experiment.tuning_drives import Stretch
from navlearn.experiment.tuning_verdict import UNJUDGED, TuningVerdict, judged
from navlearn.experiment.tuning_ways import METHODS, TuningMethod, by_gradient, by_rule
from navlearn.learning.noise_figures import NoiseFigures
from navlearn.learning.noise_options import TuningOptions
from navlearn.recipe import Recipe
from navlearn.recipe.tuned_spec import TunedSpec, write_tuned


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
        found = by_gradient(recipe, logs, before, tuning, checkpoint, progress)
    else:
        found = by_rule(recipe, logs, before, method)
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
