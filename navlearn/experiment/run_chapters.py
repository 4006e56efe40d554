"""What the report of one drive's run tells beside the comparison of its methods."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from navlearn.experiment.drive import Drive
from navlearn.experiment.observability import observability_chapter
from navlearn.experiment.refusals import filters_of, refusals
from navlearn.frames import ecef_from_geodetic
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.fit_diagnostics import FitDiagnostics, fit_section
from navlearn.outages.fit_plots import write_fit_diagnostics
from navlearn.outages.output import OutputFolder
from navlearn.outages.refused_report import write_refusals
from navlearn.outages.run_summary import Chapter
from navlearn.recipe import Recipe
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec


def run_chapters(
    recipe: Recipe, drive: Drive, fits: Mapping[str, FitDiagnostics], output: OutputFolder
) -> tuple[Chapter, ...]:
    """Write what a run tells beside the comparison, and return the chapters of its report.

    Args:
        recipe: The recipe.
        drive: Its drive.
        fits: Diagnostics of the last fit of each network on a full IMU's position error, by name;
            solutions that an interrupted run had already made bring none, which is said.
        output: The run's folder.
    """
    chapters = []
    if fits:
        chapters.append(_fit_chapter(drive.log, fits, output))
    without = [name for name in _networks(recipe) if name not in fits]
    if without:
        chapters.append(Chapter(section=tuple(no_fit_section(without))))
    filters = filters_of(recipe)
    if filters:
        chapters.append(write_refusals(output, refusals(filters, drive.log), drive.log))
    if recipe.observability:
        chapters.append(observability_chapter(recipe, drive, output))
    return tuple(chapters)


def _networks(recipe: Recipe) -> list[str]:
    names = {spec.name for spec in recipe.models if isinstance(spec, InsAnarxSpec)}
    return [name for name in recipe.methods if name in names]


def no_fit_section(names: Sequence[str]) -> list[str]:
    """Return what a report says of networks of whose fits it knows nothing.

    Args:
        names: Their names.
    """
    return [
        "## Networks without a fit to show\n",
        f"{', '.join(f'`{name}`' for name in names)}: no network was fitted when this report was "
        "written. Either the solutions were there already, from a run that was interrupted (run "
        "again with `--force` to have the fits, too), or there was too little to learn from "
        "(`reason` in `outages.csv` tells).\n",
    ]


def _fit_chapter(
    log: DriveLog, fits: Mapping[str, FitDiagnostics], output: OutputFolder
) -> Chapter:
    judged = [_with_reference(one, log) for one in fits.values()]
    figures = write_fit_diagnostics(output, judged)
    return Chapter(section=tuple(fit_section(judged)), figures=figures)


def _with_reference(one: FitDiagnostics, log: DriveLog) -> FitDiagnostics:
    """Return diagnostics with the reference, by which a path along Earth-fixed axes is judged."""
    known = log.reference
    if known is None or "height" not in known:
        return one
    known = known.dropna(subset=["lat", "lon", "height"])
    place = (torch.tensor(known[name].to_numpy(np.float64)) for name in ("lat", "lon", "height"))
    return one.with_truth(known["t"].to_numpy(np.float64), ecef_from_geodetic(*place).numpy())
