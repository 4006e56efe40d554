"""What the full-IMU filter of a recipe observed over a drive, all outages taken out of it."""

from dataclasses import replace

import numpy as np

from navlearn.experiment.drive import Drive
from navlearn.experiment.ins_filter_runs import InsFilterRuns
from navlearn.fusion.ins.layout import INS_ERROR_UNITS, ins_layout
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.observability_record import ObservabilityRecord, observability_of_run
from navlearn.outages.observability_report import write_observability
from navlearn.outages.output import OutputFolder
from navlearn.outages.run_summary import Chapter
from navlearn.outages.schedule import Outage


def observability_chapter(runs: InsFilterRuns, drive: Drive, output: OutputFolder) -> Chapter:
    """Write what a recipe's full-IMU filter observed, and return what the report says of it.

    Args:
        runs: Filter runs of the recipe.
        drive: Its drive.
        output: The run's folder.
    """
    outages = drive.placement.outages
    record = observed(runs, without_outages(drive.log, outages))
    whose = f"`ins_ekf` on {drive.log.metadata.name}, all outages taken out of one run"
    found = write_observability(output, record, outages, whose=whose)
    return Chapter(section=found.section, figures=found.figures)


def observed(runs: InsFilterRuns, log: DriveLog) -> ObservabilityRecord:
    """Return the degree of observability over a run of a recipe's filter.

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
