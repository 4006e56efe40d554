"""Which gyro error terms a fleet of drives says are worth estimating.

    from navlearn.experiment.gyro_term_choice import choose_gyro_terms, save_augmented_spec
    choice = choose_gyro_terms([read_log(path) for path in drives], load_recipe(recipe))
    save_augmented_spec(choice, "models/mine.yaml")

Then ``navlearn evaluate --model models/mine.yaml``. The drives should be others than those that
the model is judged on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd
import torch
import yaml
from torch import Tensor

from navlearn.errors import ConfigError
from navlearn.experiment.augmented_filter import AMOUNT, cooled
from navlearn.experiment.baselines import FilterRuns, filter_options
from navlearn.experiment.drive import set_clocks, timeline_of
from navlearn.fusion.sensor_errors import gyro_regressor
from navlearn.learning.azimuth_regression import AzimuthNoise, azimuth_curve, whitened_rows
from navlearn.learning.group_search import search_groups
from navlearn.logs.drive_log import DriveLog
from navlearn.navigator import NavigatorRun
from navlearn.recipe import Recipe
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.states import RissSample

CANDIDATES: Final = ("scale", "abs_scale", "quadratic", "f_x", "f_y", "temperature")
"""Terms that the filter can estimate beside the bias, which it always does."""


@dataclass(frozen=True, kw_only=True)
class GyroTermChoice:
    """Terms chosen over several drives.

    Attributes:
        terms: Chosen terms, in order of what they explain.
        table: A row per chosen term, then the best of the others: ``term``, ``chosen``,
            ``reduction`` (energy of azimuth errors taken away, in units of the noise of a row,
            summed over drives), ``drives`` (in how many it took away more than the two that a
            coefficient costs).
        asked: Reduction that one more term would have had to reach.
        drives: Names of the drives.
    """

    terms: tuple[str, ...]
    table: pd.DataFrame
    asked: float
    drives: tuple[str, ...]


def choose_gyro_terms(
    logs: Sequence[DriveLog],
    recipe: Recipe,
    *,
    candidates: tuple[str, ...] = CANDIDATES,
    max_terms: int = 6,
    false_alarm: float = 0.05,
    noise: AzimuthNoise | None = None,
) -> GyroTermChoice:
    """Choose the gyro error terms that matter over drives, by fast orthogonal search.

    What counts is the azimuth error that outages of any start and length would have had in the
    drives; each drive has coefficients of its own, the terms are common.

    Args:
        logs: The drives; temperature is a candidate where all of them tell it.
        recipe: Tells the filter, the mechanization and how clocks are set; its log is not read.
        candidates: Terms to choose among, any of :data:`CANDIDATES`.
        max_terms: Most terms.
        false_alarm: Chance that white noise alone has a term accepted.
        noise: What azimuth errors hold beside the terms; None for that of the default gyro.

    Returns:
        The choice.

    Raises:
        ConfigError: A candidate is unknown, or there is no drive.
        FitError: A drive is too short.
    """
    unknown = [name for name in candidates if name not in CANDIDATES]
    if unknown or not candidates or not logs:
        raise ConfigError(
            f"gyro terms: {len(logs)} drives and candidates {', '.join(candidates) or 'none'}; "
            f"give drives, and candidates among {', '.join(CANDIDATES)}"
        )
    logs = [set_clocks(log, recipe, float("inf"))[0] for log in logs]
    if any(cooled(log) is None for log in logs):
        candidates = tuple(name for name in candidates if name != "temperature")
    runs = FilterRuns(recipe)
    rows = [_rows(runs, log, candidates, noise or AzimuthNoise()) for log in logs]
    found = search_groups(
        [one[0] for one in rows],
        [one[1] for one in rows],
        max_terms=max_terms,
        false_alarm=false_alarm,
    )
    terms = tuple(candidates[k] for k in found.chosen)
    lines = [
        {"term": name, "chosen": True, **_told(part)}
        for name, part in zip(terms, found.reduction, strict=True)
    ]
    if len(terms) < len(candidates):
        lines.append({"term": "best left out", "chosen": False, **_told(found.next_best)})
    return GyroTermChoice(
        terms=terms,
        table=pd.DataFrame(lines),
        asked=found.asked,
        drives=tuple(log.metadata.name for log in logs),
    )


def save_augmented_spec(choice: GyroTermChoice, path: str | Path) -> Path:
    """Write the spec of a filter with the chosen terms.

    Args:
        choice: The choice.
        path: YAML file to write; its stem becomes the model's name.

    Returns:
        The file.

    Raises:
        ConfigError: The file exists, or its name cannot be a model's.
    """
    path = Path(path)
    if path.exists():
        raise ConfigError(f"{path}: exists already; choose another name or remove it")
    spec = AugmentedSpec(
        name=path.stem,
        question="Do the gyro terms that other drives chose help on this one?",
        notes=f"terms chosen by fast orthogonal search over {', '.join(choice.drives)}",
        gyro_terms=("bias", *choice.terms),
    )
    content = spec.model_dump(mode="json")
    path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")
    return path


def _told(reduction: Tensor) -> dict[str, object]:
    return {"reduction": float(reduction.sum()), "drives": int((reduction > 2.0).sum())}


def _rows(
    runs: FilterRuns, log: DriveLog, candidates: tuple[str, ...], noise: AzimuthNoise
) -> tuple[Tensor, Tensor]:
    """Return independent rows of azimuth errors and what every candidate would explain of them."""
    options = filter_options(runs.recipe, log=log)
    timeline, _, run = runs.run(log, options)
    warmth = torch.zeros_like(run.samples.dt)
    other = cooled(log) if "temperature" in candidates else None
    if other is not None:
        rates = timeline_of(other, runs.recipe).samples.yaw_rate
        warmth = ((timeline.samples.yaw_rate - rates) / AMOUNT)[run.first :]
    terms = torch.stack([_regressor(name, run, warmth) for name in candidates], -1)
    curve = azimuth_curve(run, options, terms, len(run.samples.dt))
    rows = whitened_rows(curve, noise)
    return rows.columns, rows.target


def _regressor(name: str, run: NavigatorRun, warmth: Tensor) -> Tensor:
    if name == "temperature":
        return warmth
    # the kink of |ω| lies where the car goes straight, not where a biased gyro reads zero
    level: RissSample = run.samples._replace(
        yaw_rate=run.samples.yaw_rate - run.alignment.gyro_bias
    )
    return gyro_regressor(name, level)
