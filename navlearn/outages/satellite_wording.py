"""Says in plain words what few satellites leave of the error, and what coupling tightly gains."""

import math

import pandas as pd

from navlearn.outages.markdown import number
from navlearn.outages.roles import from_paper
from navlearn.outages.satellite_tables import satellites_of
from navlearn.outages.sweep_summary import SweepSummary
from navlearn.outages.wording import percent


def satellite_meaning(summary: SweepSummary) -> list[str]:
    """Return a paragraph per class and duration, nothing where all GNSS is always gone.

    Args:
        summary: The sweep.
    """
    table = satellites_of(summary)
    if table is None:
        return []
    return [
        f"**Few satellites, {gyro_class}, {duration:g} s.** " + _sentences(summary, part)
        for (gyro_class, duration), part in table.groupby(["gyro_class", "duration_s"], sort=False)
    ]


def _sentences(summary: SweepSummary, part: pd.DataFrame) -> str:
    numbers = " / ".join(str(one) for one in part["satellites"].unique())
    mine = part[part["against"] == part["against"].iloc[0]]
    errors = ", ".join(
        f"**{name}** {' / '.join(number(mean) for mean in lines['rms_mean'])} m"
        for name, lines in mine.groupby("method", sort=False)
    )
    said = f"Mean RMS error with {numbers} satellites: {errors}."
    for other in (name for name in summary.also_against if name in set(part["against"])):
        lines = part[(part["against"] == other) & (part["method"] == summary.baseline)]
        said += f" Against **{other}**, **{summary.baseline}** gains {_gains(lines)}."
    for name in mine["method"].unique():
        if from_paper(name):
            said += f" The paper's **{name}** against **{summary.baseline}**: "
            said += f"{_gains(mine[mine['method'] == name])}."
    return said


def _gains(lines: pd.DataFrame) -> str:
    return " / ".join(_gain(line) for _, line in lines.iterrows())


def _gain(line: "pd.Series") -> str:
    low, high = float(line["rms_low_percent"]), float(line["rms_high_percent"])
    gain = percent(float(line["rms_improvement_percent"]))
    if not math.isfinite(low + high):
        return gain
    return f"{gain} ({percent(low).removesuffix(' %')} to {percent(high)})"
