"""What the filter of a recipe observed over a drive, all outages taken out of it."""

from dataclasses import replace

import numpy as np

from navlearn.experiment.baselines import FilterRuns
from navlearn.experiment.drive import Drive
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.fusion.error_state import ERROR_UNITS
from navlearn.fusion.ins.layout import INS_ERROR_UNITS, ins_layout
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.observability_record import ObservabilityRecord, observability_of_run
from navlearn.outages.observability_report import write_observability
from navlearn.outages.output import OutputFolder
from navlearn.outages.run_summary import Chapter
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe


def observability_chapter(recipe: Recipe, drive: Drive, output: OutputFolder) -> Chapter:
    """Write what a recipe's filter observed, and return what the report says of it.

    Args:
        recipe: The recipe; its ``mechanization.sensors`` tells whose filter.
        drive: Its drive.
        output: The run's folder.
    """
    outages = drive.placement.outages
    known = without_outages(drive.log, outages)
    if recipe.mechanization.sensors == "imu":
        record, name = observed_by_imu(InsFilterRuns(recipe), known), "ins_ekf"
    else:
        record, name = observed_by_riss(FilterRuns(recipe), known), "ekf"
    whose = f"`{name}` on {drive.log.metadata.name}, all outages taken out of one run"
    return write_observability(output, record, outages, whose=whose)


def observed_by_imu(runs: InsFilterRuns, log: DriveLog) -> ObservabilityRecord:
    """Return the degree of observability over a run of a recipe's full-IMU filter.

    Args:
        runs: Filter runs of the recipe.
        log: The drive.
    """
    line, navigator, run = runs.run(log)
    history, layout = run.history, ins_layout(navigator.options.filter)
    ends = run.first + history.end
    return observability_of_run(
        history.belief.covariance,
        navigator.start(run.alignment).covariance,
        line.t[ends],
        start_time=float(line.t[run.first] - run.samples.dt[0]),
        names=layout.names,
        units={name: INS_ERROR_UNITS[name] for name in layout.names},
        still=line.samples.stationary[ends],
    )


def observed_by_riss(runs: FilterRuns, log: DriveLog) -> ObservabilityRecord:
    """Return the degree of observability over a run of a recipe's filter of gyro and odometer.

    Args:
        runs: Filter runs of the recipe.
        log: The drive.
    """
    line, navigator, run = runs.run(log)
    history, names = run.history, navigator.filter.model.layout.names
    ends = run.first + history.end
    return observability_of_run(
        history.belief.covariance,
        navigator.start(run.alignment).covariance,
        line.t[ends],
        start_time=float(line.t[run.first] - run.samples.dt[0]),
        names=names,
        units={name: ERROR_UNITS[name] for name in names if name in ERROR_UNITS},
        still=line.samples.stationary[ends],
    )


def without_outages(log: DriveLog, outages: tuple[Outage, ...]) -> DriveLog:
    """Return a log without the fixes of any outage; those between them stay.

    Args:
        log: The drive.
        outages: The outages.
    """
    t = log.fixes["t"].to_numpy()
    inside = np.zeros(t.shape, dtype=np.bool_)
    for outage in outages:
        inside |= (t >= outage.start) & (t <= outage.end)
    return replace(log, fixes=log.fixes[~inside].reset_index(drop=True))
