"""What a run tells of the satellites that stayed, and its picture of the sky."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.maps import Scene
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.placement import place_outages
from navlearn.outages.replay import Solution, replay
from navlearn.outages.report import report_text
from navlearn.outages.results import write_results
from navlearn.outages.run_summary import DriveSummary, MethodSummary, RunSummary
from navlearn.outages.schedule import Outage, OutageProtocol


class Still:
    """Knows the truth, but for its height."""

    def __init__(self, truth: DriveLog) -> None:
        self.truth = truth

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        assert self.truth.reference is not None
        known = self.truth.reference
        part = known[(known["t"] >= outage.start) & (known["t"] <= outage.end)]
        off = 1e-7 * len(log.ranges[log.ranges["t"] >= outage.start]["satellite"].unique())
        return Solution(table=part.assign(lat=part["lat"] + 1e-6 - off))


def test_a_run_tells_which_satellites_stayed_and_shows_the_sky(
    make_log: Callable[..., DriveLog],
    with_ranges: Callable[..., DriveLog],
    tmp_path: Path,
) -> None:
    log = with_ranges(make_log(duration=600.0, azimuth=lambda t: 0.5 + 0.3 * np.sin(t / 20.0)))
    protocol = OutageProtocol(count=3, warm_up=100.0, satellites=2, visible="best_geometry")
    placed = place_outages(protocol, log)
    done = replay(log, placed.outages, {"ekf": Still(log)}, progress=False)
    summary = RunSummary(
        title="t", question="q",
        drives=(
            DriveSummary(
                name="made", source="", duration=600.0, distance=1.0, placement=placed
            ),
        ),
        protocol=protocol, methods={"ekf": MethodSummary(description="d")}, rows=done.rows,
        command="c", versions={},
    )  # fmt: skip
    output = prepare_output_folder(tmp_path / "run")
    scene = Scene(log=log, outages=placed.outages, replay=done)
    written = write_results(output, summary, [scene])
    assert "sky.png" in written.figures
    assert (output.path / "sky.png").stat().st_size > 10_000
    text = (output.path / "report.md").read_text(encoding="utf-8")
    names = " ".join(placed.outages[0].satellites_visible)
    assert "but within the outage those of 2 satellites (`best_geometry`)" in text
    assert "through each outage 2 satellites stay, those whose ranges tell most" in text
    assert "| outage | start s | dynamics | satellites | distance m | ekf |" in text
    assert f"| {names} |" in text
    back = pd.read_csv(output.path / "outages.csv")
    assert back["satellites"].tolist() == [2, 2, 2]
    assert back["satellites_visible"].tolist() == [names] * 3
    content = json.loads((output.path / "summary.json").read_text(encoding="utf-8"))
    assert content["protocol"]["satellites"] == 2
    none = replace(summary, protocol=OutageProtocol(), rows=done.rows.assign(satellites=0))
    assert "nor any raw range. Not scored" in report_text(none)
    assert "| dynamics | distance m |" in report_text(none)
