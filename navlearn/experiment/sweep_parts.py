"""The parts of a sweep: which drives are run under which outages, and what of them is missing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from navlearn.experiment.refusals import filters_of
from navlearn.experiment.sweep_jobs import SweepJob, rows_file
from navlearn.experiment.sweep_sources import Sources
from navlearn.outages.output import OutputFolder
from navlearn.recipe.sweep import SweepRecipe
from navlearn.recipe.swept_drives import Conditions


@dataclass(frozen=True, kw_only=True)
class Part:
    """One drive under one kind of outages.

    Attributes:
        grade: Sensor grade of the drive.
        seed: Its seed.
        kind: Its outages.
        file: The file with its rows.
        refused: The file with what filters refused over the whole drive; None where no method is
            a filter, and for all kinds of outages but the drive's first.
    """

    grade: str
    seed: int
    kind: Conditions
    file: Path
    refused: Path | None


def parts_of(recipe: SweepRecipe, output: OutputFolder, sources: Sources) -> list[Part]:
    """Return the parts of a sweep, in the order of its tables.

    Args:
        recipe: The sweep.
        output: Its folder.
        sources: What its drives are made of.
    """
    rows, refused = output.claim("rows/"), None
    if filters_of(recipe.for_drive("any", recipe.sweep.durations_s[0])):
        refused = output.claim("refused/")
    parts, begun = list[Part](), set[tuple[str, int]]()
    for grade in recipe.sweep.grades:
        for kind in recipe.conditions:
            for seed in recipe.sweep.seeds:
                if (seed, kind.duration) not in sources:
                    continue
                name = rows_file(recipe, grade, seed, kind, sources[seed, kind.duration])
                first = refused is not None and (grade, seed) not in begun
                begun.add((grade, seed))
                part = Part(
                    grade=grade,
                    seed=seed,
                    kind=kind,
                    file=rows / name,
                    refused=(refused / name).with_suffix(".json") if refused and first else None,
                )
                parts.append(part)
    return parts


def jobs_of(recipe: SweepRecipe, parts: Sequence[Part]) -> list[SweepJob]:
    """Return what is left to be run, a job per drive.

    Seed by seed over the classes: an interrupted sweep has some of every class.

    Args:
        recipe: The sweep.
        parts: Its parts.
    """
    jobs = []
    for seed in recipe.sweep.seeds:
        for grade in recipe.sweep.grades:
            mine = [part for part in parts if (part.grade, part.seed) == (grade, seed)]
            files = {part.kind: part.file for part in mine if not part.file.exists()}
            refused = None
            for part in mine:
                if part.refused is not None and not part.refused.exists():
                    refused = part.kind, part.refused
            if files or refused is not None:
                job = SweepJob(recipe=recipe, grade=grade, seed=seed, files=files, refused=refused)
                jobs.append(job)
    return jobs


def refusals_of(parts: Sequence[Part]) -> list[tuple[str, Path]]:
    """Return grade and file of what filters refused, drive by drive.

    Args:
        parts: The parts of a sweep.
    """
    return [(part.grade, part.refused) for part in parts if part.refused is not None]
