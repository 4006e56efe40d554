"""One run of the filter of one gyro behind a gate: what became of every fix, and the errors."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from navlearn.errors import LogError
from navlearn.experiment.refusals import riss_judgements
from navlearn.experiment.solution_tables import solution_table
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.options import EkfOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import RissTimeline
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.outages.detection import position_verdicts
from navlearn.outages.schedule import Outage
from navlearn.outages.state_errors import state_errors


class GatedRun(NamedTuple):
    """What one gate made of a drive.

    Attributes:
        fixes: A row per position fix, as :func:`navlearn.outages.detection.position_verdicts`.
        errors: A row per time of the reference: ``t`` (s) and ``horizontal`` error (m).
    """

    fixes: pd.DataFrame
    errors: pd.DataFrame


def gated_run(
    log: DriveLog, line: RissTimeline, gate: GateOptions, options: EkfOptions | None = None
) -> GatedRun:
    """Return what the filter makes of a drive behind a gate.

    Args:
        log: The drive, with its reference, which judges.
        line: The drive as tensors.
        gate: When a measurement is refused.
        options: The filter but for its gate; None for the defaults.

    Raises:
        LogError: The drive has no reference.
    """
    if log.reference is None:
        raise LogError(f"{log.metadata.name}: has no reference to judge positions by")
    navigator = Navigator(NavigatorOptions(filter=replace(options or EkfOptions(), gate=gate)))
    run = navigator.run(line.samples, line.fixes, line.timing)
    everything = Outage(line.start_time - 1.0, float(line.t[-1]) - line.start_time + 2.0)
    path = solution_table(line.t[run.first :], run.history.trajectory, everything)
    off = state_errors(path, log.reference)
    return GatedRun(
        position_verdicts(riss_judgements(line, navigator, run), injected_faults(log)),
        pd.DataFrame({"t": off["t"], "horizontal": np.hypot(off["latitude"], off["longitude"])}),
    )
