"""One drive of a sweep: made in memory, its outages replayed, its rows written whole or not at all.

Rows are all that is kept: full solutions of some thousand outages would fill gigabytes, and a
drive is made and replayed again within a minute.
"""

import hashlib
import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch

import navlearn
from navlearn.experiment.baselines import FilterRuns
from navlearn.experiment.drive import prepare_log
from navlearn.experiment.methods import build_methods
from navlearn.experiment.oracles import truth_for
from navlearn.experiment.run import digest_of
from navlearn.experiment.sweep_drives import gyro_class, make_drive
from navlearn.experiment.timed_method import timed
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.csv_tables import read_frame
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.outages.replay import replay
from navlearn.outages.tables import write_outages_csv
from navlearn.recipe.sweep import SweepRecipe

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
