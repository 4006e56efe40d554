"""The drives of a sweep: simulated, a real one with a gyro error added, or several real ones."""

from navlearn.errors import ConfigError
from navlearn.experiment.drive import open_log
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.logs.synthetic import jaradat2017_scenario, simulate_drive
from navlearn.logs.synthetic.degrade import degraded_drive
from navlearn.logs.synthetic.faults import with_faults
from navlearn.recipe.satellite_section import satellite_options
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import (
    CLASSES,
    DegradedDrives,
    RecordedDrives,
    ScenarioDrives,
    SimulatedDrives,
)


def gyro_class(grade: str) -> str:
    """Return the short name of a class of gyros.

    Args:
        grade: Sensor grade.
    """
    return CLASSES.get(grade, grade)


def make_drive(recipe: SweepRecipe, grade: str, seed: int) -> tuple[DriveLog, SensorTruth | None]:
    """Return a drive of a sweep, and what a simulation knows of its gyro.

    Args:
        recipe: The sweep.
        grade: Sensor grade.
        seed: Seed of the drive.
    """
    source = recipe.sweep
    if isinstance(source, SimulatedDrives):
        made = simulate_drive(
            profile=source.profile,
            grade=grade,
            duration=source.duration_s,
            seed=seed,
            imu_rate_hz=source.imu_rate_hz,
            satellites=None if source.sky is None else satellite_options(source.sky),
            name=f"{source.profile}_{grade}_{seed}",
        )
        if source.faults is not None:
            return with_faults(made.log, source.faults.options(seed)).log, made.sensor_truth
        return made.log, made.sensor_truth
    if isinstance(source, ScenarioDrives):
        made = jaradat2017_scenario(seed)
        return made.log, made.sensor_truth
    if isinstance(source, RecordedDrives):
        return real_drive(recipe, seed), None
    degraded = degraded_drive(real_drive(recipe), grade, seed)
    return degraded.log, degraded.truth


def real_drive(recipe: SweepRecipe, number: int = 0) -> DriveLog:
    """Return a real drive of a sweep: the one that gyro errors are put on, or one of several.

    Args:
        recipe: A sweep over real drives.
        number: Which of several.

    Raises:
        LogNotFoundError: It does not exist.
        LogError: It cannot be used as it is.
        ConfigError: The sweep's drives are simulated.
    """
    sweep = recipe.sweep
    if isinstance(sweep, SimulatedDrives | ScenarioDrives):
        raise ConfigError(f"{recipe.name}: its drives are simulated; there is no real one")
    source = sweep.log if isinstance(sweep, DegradedDrives) else sweep.source(number)
    return open_log(recipe.for_drive("real", 1.0).model_copy(update={"log": source}))
