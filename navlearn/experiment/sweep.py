"""Runs a sweep: many drives over several processes, resumable, then one report.

Every drive's rows are written as soon as they are there. Started again, a sweep runs what is
missing; rows of other settings or of another version are not taken for its own.
"""

import json
import shlex
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import pandas as pd
import torch
import yaml
from tqdm import tqdm

from navlearn.errors import ConfigError, FitError
from navlearn.experiment.run import check_recipe
from navlearn.experiment.sweep_drives import gyro_class
from navlearn.experiment.sweep_jobs import Failure, SweepJob, failure, read_rows, run_job
from navlearn.experiment.sweep_parts import Part, jobs_of, parts_of, refusals_of
from navlearn.experiment.sweep_sources import sources_of
from navlearn.experiment.sweep_summary import sweep_summary
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.refused_drive import read_refusals
from navlearn.outages.sweep_refusals import write_sweep_refusals
from navlearn.outages.sweep_report import sweep_content, table_of, write_sweep_report
from navlearn.recipe.sweep import SweepRecipe

TIME = "time.json"
FAILURES = "failures.json"


@dataclass(frozen=True, kw_only=True)
class SweepResult:
    """What a sweep leaves.

    Attributes:
        folder: Its folder.
        table: A row per outage and method, as ``outages.csv``.
        meaning: What the report says it means, a sentence or more each.
        failures: What could not be run; the same command tries it again.
    """

    folder: Path
    table: pd.DataFrame
    meaning: tuple[str, ...]
    failures: tuple[Failure, ...]


def run_sweep(
    recipe: SweepRecipe,
    out: Path,
    *,
    processes: int = 1,
    force: bool = False,
    progress: bool = True,
) -> SweepResult:
    """Run a sweep and write its folder.

    Args:
        recipe: The sweep.
        out: Folder for the run.
        processes: How many drives are run at once, each in a process of its own; one runs here.
        force: Replace an earlier run there.
        progress: Show a progress bar, with the time left.

    Returns:
        The folder, the table, and what failed. With failures the run does not count as
        finished: started again, it tries them again.

    Raises:
        OutputExistsError: The folder holds a finished run, or files that no run wrote.
        LogError: The real drive cannot be used; no folder is made.
        ConfigError: Parts of the recipe do not go together; no folder is made.
        FitError: Nothing could be run at all.
    """
    if processes < 1:
        raise ConfigError(f"processes: found {processes}; expected one or more")
    check_recipe(recipe.for_drive("any", recipe.sweep.durations_s[0]))
    sources, left_out = sources_of(recipe)
    output = prepare_output_folder(Path(out), force)
    text = yaml.safe_dump(recipe.resolved(), sort_keys=False, allow_unicode=True)
    output.claim("recipe.yaml").write_text(text, encoding="utf-8")
    parts = parts_of(recipe, output, sources)
    with _clock(output.claim(TIME)) as spent:
        failures = _run_all(recipe, parts, processes, progress)
    _write_failures(output.claim(FAILURES), failures)
    rows = [read_rows(part.file) for part in parts if part.file.exists()]
    if not rows:
        raise FitError(
            f"{recipe.name}: no drive could be run; the first said: {failures[0].reason}"
        )
    table = pd.concat(rows, ignore_index=True)
    refused = [
        (gyro_class(grade), read_refusals(file))
        for grade, file in refusals_of(parts)
        if file.exists()
    ]
    summary = sweep_summary(recipe, table, failures, left_out)
    command = f"navlearn run {shlex.quote(str(output.path / 'recipe.yaml'))} --out NEW_FOLDER"
    summary = write_sweep_report(
        output,
        replace(
            summary,
            command=f"{command} --processes {processes}",
            versions=recipe.resolved()["versions"],
            wall_clock=spent(),
            processes=processes,
            chapters=(write_sweep_refusals(output, refused),) if refused else (),
        ),
    )
    if not failures:
        output.finish()
    told = sweep_content(summary, table_of(summary))["meaning"]
    return SweepResult(
        folder=output.path,
        table=summary.rows,
        meaning=tuple(str(line) for line in told) if isinstance(told, list) else (),
        failures=tuple(failures),
    )


def _run_all(
    recipe: SweepRecipe, parts: Sequence[Part], processes: int, progress: bool
) -> list[Failure]:
    missing = sum(not part.file.exists() for part in parts)
    jobs, each, failures = jobs_of(recipe, parts), recipe.outages.count, list[Failure]()
    with tqdm(
        total=len(parts) * each,
        initial=(len(parts) - missing) * each,
        disable=not progress,
        unit="outage",
        smoothing=0.0,
    ) as bar:

        def done(job: SweepJob, failed: list[Failure]) -> None:
            failures.extend(failed)
            bar.set_postfix_str(f"{job.grade}_{job.seed}" + _counted(failures))
            bar.update(len(job.files) * each)

        if processes == 1 or len(jobs) < 2:
            for job in jobs:
                done(job, run_job(job))
        else:
            _run_in_processes(jobs, min(processes, len(jobs)), done)
    return failures


def _run_in_processes(
    jobs: Sequence[SweepJob], processes: int, done: Callable[[SweepJob, list[Failure]], None]
) -> None:
    pool = ProcessPoolExecutor(
        max_workers=processes, mp_context=get_context("spawn"), initializer=_start_worker
    )
    try:
        futures = {pool.submit(run_job, job): job for job in jobs}
        for future in as_completed(futures):
            job = futures[future]
            try:
                failed = future.result()
            except BrokenProcessPool:
                reason = "its process, or one beside it, was ended from outside; run it again"
                failed = [failure(job, kind, reason) for kind in job.missing]
            done(job, failed)
    except BaseException:
        # Finished drives are on disk; what is under way would only keep the caller waiting.
        for child in active_children():
            child.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _start_worker() -> None:
    # Ctrl-C reaches every process of the terminal; the first one ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


@contextmanager
def _clock(file: Path) -> Iterator[Callable[[], float]]:
    """Count the time spent, with that of earlier starts of the same sweep."""
    earlier = 0.0
    if file.exists():
        earlier = float(json.loads(file.read_text(encoding="utf-8"))["wall_clock_s"])
    begin = time.monotonic()

    def spent() -> float:
        return earlier + time.monotonic() - begin

    try:
        yield spent
    finally:
        file.write_text(json.dumps({"wall_clock_s": spent()}) + "\n", encoding="utf-8")


def _write_failures(file: Path, failures: Sequence[Failure]) -> None:
    content: list[Mapping[str, Any]] = [asdict(one) for one in failures]
    file.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _counted(failures: Sequence[Failure]) -> str:
    return f", {len(failures)} failed" if failures else ""
