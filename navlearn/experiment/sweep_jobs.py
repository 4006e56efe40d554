"""One drive of a sweep: made in memory, its outages replayed, its rows written whole or not at all.

Rows are all that is kept: full solutions of some thousand outages would fill gigabytes, and a
drive is made and replayed again within a minute.
"""

import hashlib
import json
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch

import navlearn
from navlearn.errors import ConfigError
from navlearn.experiment.baselines import FilterRuns
from navlearn.experiment.drive import open_log, prepare_log
from navlearn.experiment.methods import build_methods
from navlearn.experiment.oracles import truth_for
from navlearn.experiment.run import digest_of
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.csv_tables import read_frame
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.logs.synthetic import jaradat2017_scenario, simulate_drive
from navlearn.logs.synthetic.degrade import degraded_drive
from navlearn.outages.known_log import sees_after
from navlearn.outages.replay import BatchMethod, Method, Solution, replay
from navlearn.outages.schedule import Outage
from navlearn.outages.tables import write_outages_csv
from navlearn.recipe.sweep import (
    CLASSES,
    DegradedDrives,
    RecordedDrives,
    ScenarioDrives,
    SimulatedDrives,
    SweepRecipe,
)

CPU = "cpu_s"
"""Column with the processor time that a method took for an outage, s."""


@dataclass(frozen=True, kw_only=True)
class SweepJob:
    """One drive of a sweep.

    Attributes:
        recipe: The sweep.
        grade: Sensor grade of the drive.
        seed: Its seed.
        files: Where the rows of each length of outages go, by that length; those that are
            there already are left out.
    """

    recipe: SweepRecipe
    grade: str
    seed: int
    files: Mapping[float, Path]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """What could not be run.

    Attributes:
        grade: Sensor grade of the drive.
        seed: Its seed.
        duration: Length of the outages, s.
        reason: Why.
    """

    grade: str
    seed: int
    duration: float
    reason: str


def gyro_class(grade: str) -> str:
    """Return the short name of a class of gyros.

    Args:
        grade: Sensor grade.
    """
    return CLASSES.get(grade, grade)


def rows_file(recipe: SweepRecipe, grade: str, seed: int, duration: float, source: str) -> str:
    """Return the name of the file with a drive's rows; another setting gives another name.

    Args:
        recipe: The sweep.
        grade: Sensor grade of the drive.
        seed: Its seed.
        duration: Length of the outages, s.
        source: What the drives are made of: a hash of the real log, or nothing.
    """
    content = recipe.model_dump(mode="json", exclude={"name", "question"})
    for key in ("filter_by_grade", "ins_filter_by_grade"):
        content[key] = content[key].get(grade, {})
    # How many drives there are does not change any of them.
    for key in ("grades", "drives", "first_seed", "durations_s", "log", "logs", "aiding"):
        content["sweep"].pop(key, None)
    what = {
        "version": navlearn.__version__,
        "recipe": content,
        "trained": [digest_of(path) for spec in recipe.models for path in spec.files()],
        "drive": [grade, seed, duration, source],
    }
    key = hashlib.sha256(json.dumps(what, sort_keys=True, default=str).encode()).hexdigest()[:16]
    return f"{grade}_{seed}-{duration:g}s-{key}.csv"


def run_job(job: SweepJob) -> list[Failure]:
    """Make a drive, replay its outages and write their rows.

    Warnings are not shown: over many drives most of them are of the kind that a sweep measures.

    Args:
        job: The drive.

    Returns:
        What failed; nothing else of the sweep suffers from it.
    """
    torch.set_num_threads(1)
    failures = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            log, truth = make_drive(job.recipe, job.grade, job.seed)
        except Exception as problem:
            return [_failure(job, duration, problem) for duration in job.files]
        for duration, file in job.files.items():
            try:
                write_rows(file, outage_rows(job, log, truth, duration))
            except Exception as problem:
                failures.append(_failure(job, duration, problem))
    return failures


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
            name=f"{source.profile}_{grade}_{seed}",
        )
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


def outage_rows(
    job: SweepJob, log: DriveLog, truth: SensorTruth | None, duration: float
) -> pd.DataFrame:
    """Return the rows of a drive at one length of outages.

    Args:
        job: The drive.
        log: Its log.
        truth: What a simulation knows of its gyro.
        duration: Length of the outages, s.
    """
    recipe = job.recipe.for_drive(log.metadata.name, duration, job.grade)
    torch.manual_seed(recipe.seed)
    ready = prepare_log(log, recipe)
    knows = truth_for(recipe, ready.log, truth)
    runs = FilterRuns(recipe, growing=True)
    methods = {
        name: timed(method)
        for name, method in build_methods(recipe, truth=knows, runs=runs).items()
    }
    found = replay(ready.log, ready.placement.outages, methods, batched=True, progress=False)
    spent = [
        methods[name].spent.get(start, float("nan"))
        for name, start in zip(found.rows["method"], found.rows["start_s"], strict=True)
    ]
    return found.rows.assign(gyro_class=gyro_class(job.grade), **{CPU: spent})


class TimedMethod:
    """A method and the processor time that it took."""

    def __init__(self, method: Method) -> None:
        """Wrap a method.

        Args:
            method: The method; what it may see after an outage stays the same.
        """
        self.method = method
        self.sees_after = sees_after(method)
        self.spent: dict[float, float] = {}

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        """Return the method's solution.

        Args:
            log: What the method may know.
            outage: The outage.
        """
        before = time.process_time()
        try:
            return self.method.predict(log, outage)
        finally:
            self.spent[outage.start] = time.process_time() - before


class TimedBatchMethod(TimedMethod):
    """A method that takes several outages at once; each counts for its share of the time."""

    def predict_many(self, logs: Sequence[DriveLog], outages: Sequence[Outage]) -> list[Solution]:
        """Return the method's solutions.

        Args:
            logs: What the method may know, per outage.
            outages: The outages.
        """
        before = time.process_time()
        many: Any = self.method
        made: list[Solution] = many.predict_many(logs, outages)
        each = (time.process_time() - before) / len(outages)
        self.spent |= {outage.start: each for outage in outages}
        return made


def timed(method: Method) -> TimedMethod:
    """Return a method that notes its processor time, several outages at once where it can.

    Args:
        method: The method.
    """
    return TimedBatchMethod(method) if isinstance(method, BatchMethod) else TimedMethod(method)


def write_rows(file: Path, rows: pd.DataFrame) -> None:
    """Write rows; the file appears whole or not at all.

    Args:
        file: The file.
        rows: Rows of one drive.
    """
    part = file.with_suffix(".part")
    write_outages_csv(part, rows)
    os.replace(part, file)


def read_rows(file: Path) -> pd.DataFrame:
    """Return rows as :func:`write_rows` wrote them.

    Args:
        file: The file.
    """
    table = read_frame(file)
    empty = {name: table[name].astype(object).fillna("") for name in ("failure", "reason")}
    return table.assign(**empty)


def _failure(job: SweepJob, duration: float, problem: Exception) -> Failure:
    reason = f"{type(problem).__name__}: {problem}"
    return Failure(grade=job.grade, seed=job.seed, duration=duration, reason=reason)
