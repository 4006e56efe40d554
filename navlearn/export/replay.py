"""Running a predictor on a drive between two times."""

import pandas as pd
import torch

from navlearn.error_models.regressors import CHANNELS, average_samples, build_regressors
from navlearn.errors import ConfigError
from navlearn.export.reading import LoadedPredictor
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.resample import riss_timeline
from navlearn.states import RissSample

FINE_RATE_HZ = 10.0
"""Rate of the intervals that are averaged into the predictor's steps."""

TILTED = {"pitch", "roll"}


def predict_drive(
    predictor: LoadedPredictor, log: DriveLog, *, start: float, stop: float
) -> pd.DataFrame:
    """Return a predictor's inputs and corrections as if GNSS were gone between two times.

    Args:
        predictor: The predictor.
        log: The drive; its fixes are not looked at.
        start: Last time with GNSS, s.
        stop: End of the prediction, s.

    Returns:
        Columns ``t`` (end of each step, s), the inputs, and the corrections by their names with
        ``predicted_`` before them; of increments also the sums since the start, with ``total_``.
        Units as in the metadata.

    Raises:
        ConfigError: The times are no interval inside the log, or shorter than one step; or an
            input of the predictor is not made from a log alone.
        LogError: The log cannot be resampled.
    """
    about = predictor.metadata
    foreign = [name for name in about.inputs if name not in CHANNELS]
    if foreign:
        raise ConfigError(
            f"the predictor's inputs {', '.join(foreign)} are not made from a log alone; give them "
            "to its step or forward yourself"
        )
    block = max(1, round(FINE_RATE_HZ * about.time_step_s))
    timeline = riss_timeline(
        log, rate_hz=block / about.time_step_s, dims=3 if TILTED & set(about.inputs) else 2
    )
    first = float(timeline.start_time)
    last = float(timeline.t[-1])
    if not first <= start < stop <= last + 1e-6:
        raise ConfigError(
            f"predict from {start:g} to {stop:g} s: expected two times between {first:g} and "
            f"{last:g} s, the first before the second"
        )
    inside = (timeline.t > start + 1e-6) & (timeline.t <= stop + 1e-6)
    samples = RissSample(*(channel[inside] for channel in timeline.samples))
    if samples.dt.shape[0] < block:
        raise ConfigError(
            f"predict from {start:g} to {stop:g} s: shorter than one step of "
            f"{about.time_step_s:g} s"
        )
    inputs = build_regressors(average_samples(samples, block), about.inputs)
    with torch.no_grad():
        corrections = predictor.module(inputs.unsqueeze(0))[0]
    ends = timeline.t[inside][block - 1 :: block][: inputs.shape[0]]
    table = pd.DataFrame({"t": ends.numpy()})
    for k, name in enumerate(about.inputs):
        table[name] = inputs[:, k].numpy()
    for k, name in enumerate(about.outputs):
        table[f"predicted_{name}"] = corrections[:, k].numpy()
        if about.output_units[k].endswith("per step"):
            table[f"total_{name}"] = corrections[:, k].cumsum(0).numpy()
    return table
