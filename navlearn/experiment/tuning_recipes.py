"""Which other drives a recipe's filter may be tuned on: draws of a simulated one, logs by name."""

from collections.abc import Sequence
from pathlib import Path

from navlearn.errors import ConfigError
from navlearn.recipe import Recipe
from navlearn.recipe.log_section import SCENARIO, LogSource, SimulatedSection
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import SimulatedDrives


def recipe_of_grade(sweep: SweepRecipe, grade: str | None) -> Recipe:
    """Return the recipe of a sweep's simulated drives of one grade, its own drives unopened.

    Args:
        sweep: A sweep over simulated drives.
        grade: Which grade; None where there is only one.

    Raises:
        ConfigError: The sweep's drives are not simulated, or the grade is not among them.
    """
    made = sweep.sweep
    if not isinstance(made, SimulatedDrives):
        raise ConfigError(
            f"{sweep.name}: its drives are not simulated; tune on a recipe of one drive"
        )
    if grade is None and len(made.grades) == 1:
        grade = made.grades[0]
    if grade not in made.grades:
        raise ConfigError(
            f"{sweep.name}: found grade {grade!r}; choose one of {', '.join(made.grades)}"
        )
    drive = SimulatedSection(
        profile=made.profile,
        grade=grade,
        duration_s=made.duration_s,
        imu_rate_hz=made.imu_rate_hz,
        seed=made.first_seed,
    )
    recipe = sweep.for_drive(f"{made.profile}_{grade}", made.durations_s[0], grade)
    return recipe.model_copy(update={"log": LogSource(simulated=drive)})


def refuse_full_imu(recipe: Recipe) -> None:
    """Refuse a recipe whose filter is none that can be tuned, before its log is read.

    Args:
        recipe: The recipe.

    Raises:
        ConfigError: Its filter is that of a full IMU.
    """
    if recipe.mechanization.sensors == "imu":
        raise ConfigError(
            f"recipe {recipe.name}: mechanization.sensors is imu, and what is tuned is the filter "
            "of one gyro and an odometer, which none of its methods would take; navlearn allan "
            "finds noise for a full IMU (tuned_imu.yaml)"
        )


def other_draws(recipe: Recipe, seeds: Sequence[int], scored: Sequence[int]) -> list[Recipe]:
    """Return recipes of further draws of a simulated drive.

    Args:
        recipe: A recipe of a simulated drive.
        seeds: Seeds of the draws.
        scored: Seeds of drives that are scored.

    Raises:
        ConfigError: The drive is not simulated, or a seed is one that is scored.
    """
    made = recipe.log.simulated
    if made is None or made.profile == SCENARIO:
        raise ConfigError(
            f"recipe {recipe.name}: seeds are for simulated drives, and its log is none; name "
            "other logs with --log"
        )
    for seed in seeds:
        if seed in scored:
            raise ConfigError(
                f"recipe {recipe.name}: the drive of seed {seed} is scored; tune on other seeds"
            )
    return [_with_source(recipe, made.model_copy(update={"seed": seed})) for seed in seeds]


def _with_source(recipe: Recipe, made: SimulatedSection) -> Recipe:
    return recipe.model_copy(update={"log": recipe.log.model_copy(update={"simulated": made})})


def other_logs(recipe: Recipe, paths: Sequence[Path]) -> list[Recipe]:
    """Return the recipe on other logs.

    Args:
        recipe: The recipe.
        paths: Logs, or descriptors of logs.
    """
    described = {".yaml", ".yml"}
    return [
        recipe.model_copy(
            update={
                "log": LogSource(descriptor=path.resolve())
                if path.suffix.lower() in described
                else LogSource(path=path.resolve())
            }
        )
        for path in paths
    ]
