"""One drive of a sweep: made in memory, its outages replayed, its rows written whole or not at all.

Rows are what is kept, and what filters refused: full solutions of some thousand outages would fill
gigabytes, and a drive is made and replayed again within a minute.
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
from navlearn.experiment.drive import Drive, prepare_log
from navlearn.experiment.methods import build_methods
from navlearn.experiment.oracles import truth_for
from navlearn.experiment.refusals import filters_of, refusals
from navlearn.experiment.run import digest_of
from navlearn.experiment.sweep_drives import gyro_class, make_drive
from navlearn.experiment.timed_method import TimedMethod, timed
from navlearn.experiment.tuned_elsewhere import check_tuned
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.csv_tables import read_frame
from navlearn.logs.sensor_truth import SensorTruth
from navlearn.outages.refused_drive import DriveRefusals, drive_refusals, save_refusals
from navlearn.outages.replay import replay
from navlearn.outages.tables import write_outages_csv
from navlearn.recipe import Recipe
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import Conditions

CPU = "cpu_s"
"""Column with the processor time that a method took for an outage, s."""


@dataclass(frozen=True, kw_only=True)
class SweepJob:
    """One drive of a sweep.

    Attributes:
        recipe: The sweep.
        grade: Sensor grade of the drive.
        seed: Its seed.
        files: Where the rows of each length of outages and number of satellites go; those that
            are there already are left out.
        refused: Where what its filters refused goes, and the outages for which its clocks are set
            then; None where that is there already, or where no method is a filter.
    """

    recipe: SweepRecipe
    grade: str
    seed: int
    files: Mapping[Conditions, Path]
    refused: tuple[Conditions, Path] | None = None

    @property
    def missing(self) -> list[Conditions]:
        """Outages whose rows are not there, or those that stand for what was refused."""
        rows = [kind for kind, file in self.files.items() if not file.exists()]
        if rows or self.refused is None or self.refused[1].exists():
            return rows
        return [self.refused[0]]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """What could not be run.

    Attributes:
        grade: Sensor grade of the drive.
        seed: Its seed.
        duration: Length of the outages, s.
        satellites: How many stay.
        reason: Why.
    """

    grade: str
    seed: int
    duration: float
    satellites: int
    reason: str

    @property
    def where(self) -> str:
        """The drive and its outages, in words."""
        stay = f", {self.satellites} satellites" if self.satellites else ""
        return f"{self.grade} seed {self.seed}, {self.duration:g} s{stay}"


def rows_file(recipe: SweepRecipe, grade: str, seed: int, kind: Conditions, source: str) -> str:
    """Return the name of the file with a drive's rows; another setting gives another name.

    Args:
        recipe: The sweep.
        grade: Sensor grade of the drive.
        seed: Its seed.
        kind: Its outages.
        source: What the drives are made of: a hash of the real log, or nothing.
    """
    content = recipe.model_dump(mode="json", exclude={"name", "question"})
    for key in ("filter_by_grade", "ins_filter_by_grade", "tuned_by_grade"):
        content[key] = content[key].get(grade, {})
    # How many drives there are does not change any of them.
    shared = ("grades", "drives", "first_seed", "durations_s", "satellites")
    for key in (*shared, "log", "logs", "aiding"):
        content["sweep"].pop(key, None)
    what = {
        "version": navlearn.__version__,
        "recipe": content,
        "trained": [digest_of(path) for spec in recipe.models for path in spec.files()],
        # The most that stay anywhere decide which outages are scored.
        "drive": [grade, seed, *kind, max(recipe.sweep.satellites), source],
    }
    key = hashlib.sha256(json.dumps(what, sort_keys=True, default=str).encode()).hexdigest()[:16]
    stay = f"-{kind.satellites}" if max(recipe.sweep.satellites) else ""
    return f"{grade}_{seed}-{kind.duration:g}s{stay}-{key}.csv"


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
            return [failure(job, kind, problem) for kind in job.missing]
        methods: dict[str, TimedMethod] = {}
        length = None
        for kind, file in job.files.items():
            # What lies before an outage is the same whichever satellites stay through it.
            methods, length = methods if kind.duration == length else {}, kind.duration
            try:
                write_rows(file, outage_rows(job, log, truth, kind, methods))
            except Exception as problem:
                failures.append(failure(job, kind, problem))
        if job.refused is not None:
            kind, file = job.refused
            try:
                save_refusals(file, _refused_on(job, log, kind))
            except Exception as problem:
                # what keeps the rows from being made was told with them
                failures = failures or [failure(job, kind, problem)]
    return failures


def _refused_on(job: SweepJob, log: DriveLog, kind: Conditions) -> DriveRefusals:
    """Return what the filters of a sweep refused over a whole drive, as a single run tells it."""
    recipe, ready = _ready(job, log, kind)
    # not by the runs of the outages: those depend on which outages were left to be run
    return drive_refusals(refusals(filters_of(recipe), ready.log), ready.log)


def _ready(job: SweepJob, log: DriveLog, kind: Conditions) -> tuple[Recipe, Drive]:
    recipe = job.recipe.for_drive(log.metadata.name, kind.duration, job.grade, kind.satellites)
    torch.manual_seed(recipe.seed)
    ready = prepare_log(log, recipe)
    check_tuned(recipe, ready.log, ready.placement.outages)
    return recipe, ready


def outage_rows(
    job: SweepJob,
    log: DriveLog,
    truth: SensorTruth | None,
    kind: Conditions,
    methods: dict[str, TimedMethod] | None = None,
) -> pd.DataFrame:
    """Return the rows of a drive at one length of outages and one number of satellites.

    Args:
        job: The drive.
        log: Its log.
        truth: What a simulation knows of its gyro.
        kind: The outages.
        methods: Methods of the drive at the same length, so that what they worked out before an
            outage need not be worked out again; an empty one is filled.
    """
    recipe, ready = _ready(job, log, kind)
    methods = {} if methods is None else methods
    if not methods:
        knows, runs = truth_for(recipe, ready.log, truth), FilterRuns(recipe, growing=True)
        built = build_methods(recipe, truth=knows, runs=runs)
        methods |= {name: timed(method) for name, method in built.items()}
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
    texts = ("failure", "reason", "satellites_visible")
    return table.assign(**{name: table[name].astype(object).fillna("") for name in texts})


def failure(job: SweepJob, kind: Conditions, problem: Exception | str) -> Failure:
    """Return what could not be run of a job, and why.

    Args:
        job: The job.
        kind: Which of its outages.
        problem: Why.
    """
    told = isinstance(problem, str)
    return Failure(
        grade=job.grade,
        seed=job.seed,
        **kind._asdict(),
        reason=str(problem) if told else f"{type(problem).__name__}: {problem}",
    )
