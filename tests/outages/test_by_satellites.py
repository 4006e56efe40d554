"""Tables, figures and words by the number of satellites that stay."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.outages.cells import cell_of, conditions
from navlearn.outages.leaks import leak_warnings
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.published import PublishedTable
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.satellite_plots import plot_by_satellites
from navlearn.outages.satellite_tables import (
    mean_with_interval,
    satellite_section,
    satellite_table,
)
from navlearn.outages.statistics import compare, error_table
from navlearn.outages.sweep_report import rows_by_cell, satellites_of, table_of, write_sweep_report
from navlearn.outages.sweep_summary import SweepCell, SweepSummary
from navlearn.outages.sweep_text import sweep_text
from navlearn.outages.sweep_wording import sweep_meaning

METHODS = {
    "tc_ekf": MethodSummary(description="coupled tightly"),
    "ekf": MethodSummary(description="coupled loosely"),
    "tc_ekf+pci": MethodSummary(description="with a model", regime="online"),
}
NUMBERS = (3, 2, 1, 0)
DRIVES = tuple(f"S_{k}" for k in range(7))
GAINS = {3: 0.6, 2: 0.8, 1: 1.0, 0: 1.0}


@pytest.fixture(scope="module")
def rows(make_rows: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    """Seven drives of four outages; tight coupling gains with satellites, the model less so."""
    parts = []
    for number in NUMBERS:
        factors = {"tc_ekf": 1.0, "ekf": 1.0 + number, "tc_ekf+pci": GAINS[number]}
        part = make_rows(
            factors, {"tc_ekf+pci": True}, drives=DRIVES, outages=4, seed=number, satellites=number
        )
        rms = 0.5 * part["max_horizontal_error_m"] * np.where(part["outage"] == 2, 1.3, 1.0)
        parts.append(part.assign(gyro_class="S", rms_horizontal_error_m=rms))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture(scope="module")
def sweep(rows: pd.DataFrame) -> SweepSummary:
    return SweepSummary(
        title="Few satellites",
        question="What is left?",
        rows=rows,
        cells=tuple(
            SweepCell(gyro_class="S", duration=60.0, satellites=number, drives=DRIVES)
            for number in NUMBERS
        ),
        methods=METHODS,
        command="navlearn run",
        versions={},
        baseline="tc_ekf",
        also_against=("ekf",),
        metric="rms_horizontal_error_m",
        published=(
            PublishedTable(
                source="Iqbal2020",
                caption="Improvement of the average RMS position error",
                columns=("satellites", "improvement %"),
                rows=((3, 38.68), (2, 16.48), (1, 0), (0, 0)),
                remark="another drive: the two do not compare",
            ),
        ),
        resamples=500,
    )


@pytest.fixture(scope="module")
def table(sweep: SweepSummary) -> pd.DataFrame:
    found = satellites_of(sweep)
    assert found is not None
    return found


def test_each_line_agrees_with_its_own_outages(rows: pd.DataFrame, table: pd.DataFrame) -> None:
    assert list(dict.fromkeys(table["satellites"])) == [3, 2, 1, 0]
    assert len(table) == 4 * 3 * 2
    lines = table.set_index(["satellites", "method", "against"])
    for number in NUMBERS:
        part = rows[rows["satellites"] == number]
        for short in ("rms", "max"):
            metric = f"{short}_horizontal_error_m"
            wide = error_table(part, metric)
            line = lines.loc[(number, "tc_ekf+pci", "tc_ekf")]
            assert line[f"{short}_mean"] == pytest.approx(wide["tc_ekf+pci"].mean())
            gain = 100.0 * (1.0 - wide["tc_ekf+pci"].sum() / wide["tc_ekf"].sum())
            assert line[f"{short}_improvement_percent"] == pytest.approx(gain)
            one = compare(part, "tc_ekf+pci", "tc_ekf", metric=metric, resamples=500)
            assert (line[f"{short}_low_percent"], line[f"{short}_high_percent"]) == (
                one.low_percent,
                one.high_percent,
            )
            assert line[f"{short}_harm_count"] == one.harm_count
            tight = lines.loc[(number, "tc_ekf", "ekf")]
            gain = 100.0 * (1.0 - wide["tc_ekf"].sum() / wide["ekf"].sum())
            assert tight[f"{short}_improvement_percent"] == pytest.approx(gain)
        assert (line["outages"], line["units"], line["drawn_by"]) == (28, 7, "drive")
    assert lines.loc[(0, "tc_ekf+pci", "tc_ekf"), "max_improvement_percent"] == 0.0
    assert np.isnan(lines.loc[(3, "tc_ekf", "tc_ekf"), "rms_improvement_percent"])


def test_the_interval_of_a_mean_is_drawn_by_drive() -> None:
    # Outages of a drive are alike, so the deviation is that of seven drives, not of 70 outages.
    rng = np.random.default_rng(1)
    of_drive = rng.normal(20.0, 3.0, 7)
    index = pd.MultiIndex.from_product([range(7), range(10)], names=["drive", "outage"])
    values = pd.Series(np.repeat(of_drive, 10), index=index)
    mean, low, high = mean_with_interval(values, resamples=20_000)
    half = 2.4469 * of_drive.std(ddof=1) / np.sqrt(7.0)  # Student's t, 6 degrees of freedom
    assert mean == pytest.approx(of_drive.mean())
    assert 0.5 * (high - low) == pytest.approx(half, rel=0.12)
    alone = values.loc[[0]].iloc[:1]
    assert np.isnan(mean_with_interval(alone)[1])


def test_of_one_drive_it_is_drawn_by_outage(rows: pd.DataFrame) -> None:
    one = satellite_table(rows[rows["drive"] == "S_0"], METHODS, ("tc_ekf",), resamples=200)
    assert set(one["drawn_by"]) == {"outage"}
    assert set(one["units"]) == {4}
    text = "\n".join(satellite_section(one))
    assert "drawn by outage" in text
    assert "against `ekf`" not in text


def test_an_outage_that_failed_is_counted(rows: pd.DataFrame) -> None:
    lost = (rows["method"] == "tc_ekf+pci") & (rows["drive"] == "S_1") & (rows["outage"] == 3)
    spoilt = rows.copy()
    columns = ["rms_horizontal_error_m", "max_horizontal_error_m"]
    spoilt.loc[lost & (rows["satellites"] == 2), columns] = np.nan
    found = satellite_table(spoilt, METHODS, ("tc_ekf",), resamples=200)
    line = found.set_index(["satellites", "method"]).loc[(2, "tc_ekf+pci")]
    whole = satellite_table(rows, METHODS, ("tc_ekf",), resamples=200)
    before = whole.set_index(["satellites", "method"]).loc[(2, "tc_ekf+pci")]
    assert (line["outages"], line["failed"]) == (28, 1)
    assert line["rms_harm_count"] == before["rms_harm_count"] + 1


def test_the_files_and_the_report(sweep: SweepSummary, tmp_path: Path) -> None:
    output = prepare_output_folder(tmp_path / "sweep")
    written = write_sweep_report(output, sweep)
    assert set(written.figures) == {"improvement.png", "satellites.png"}
    for name in ("satellites.csv", "satellites.png", "improvement.png", "cells.csv"):
        assert (output.path / name).stat().st_size > 1000
    back = pd.read_csv(output.path / "satellites.csv")
    content = json.loads((output.path / "summary.json").read_text(encoding="utf-8"))
    assert len(content["by_satellites"]) == len(back) == 24
    assert content["cells"][0]["satellites"] == 3
    text = (output.path / "report.md").read_text(encoding="utf-8")
    for line in (
        "## By number of satellites",
        "**S, 60 s, against `tc_ekf`.**",
        "**S, 60 s, against `ekf`.**",
        "| method | S, 60 s, 3 satellites | S, 60 s, 2 satellites | S, 60 s, 1 satellite | S, 60 s,"
        " no satellite |",
        "### S, 60 s, no satellite",
        "**Class S, 60 s, 3 satellites** (28 outages of 7 drives; **tc_ekf** is off by",
        "| 2 | 16.48 |",
        "![Mean error over the outages against the number of satellites",
    ):
        assert line in text, line
    # The paper's figures stand beside ours, before the table of every cell.
    places = [text.index(line) for line in ("## By number", "## The paper's table", "## Class by")]
    assert places == sorted(places)
    assert text.count("## The paper's table") == 1
    assert "NaN" not in text


def test_without_partial_outages_nothing_of_it_is_said(sweep: SweepSummary, tmp_path: Path) -> None:
    rows = sweep.rows[sweep.rows["satellites"] == 0]
    bare = replace(sweep, title="None", rows=rows, cells=sweep.cells[3:], published=())
    output = prepare_output_folder(tmp_path / "sweep")
    assert set(write_sweep_report(output, bare).figures) == {"improvement.png"}
    assert not (output.path / "satellites.csv").exists()
    text = (output.path / "report.md").read_text(encoding="utf-8")
    assert "satellite" not in text
    assert "### S, 60 s\n" in text


def test_cells_of_different_numbers_are_not_mixed(sweep: SweepSummary) -> None:
    lines = table_of(sweep)
    told = conditions(lines)
    mine = lines[lines["method"] == "tc_ekf+pci"].iloc[0]
    assert told[cell_of(mine)] == "60 s, 3 satellites"
    said = sweep_meaning(sweep, lines)
    assert said[0].startswith("**Few satellites, S, 60 s.** Mean RMS error with 3 / 2 / 1 / 0 sat")
    assert "Against **ekf**, **tc_ekf** gains +7" in said[0]
    assert said[0].endswith(" / 0 % (0 to 0 %).")
    assert any("helps: **tc_ekf+pci** +4" in line for line in said)
    assert any("no satellite** (28 outages" in line and "never acted" in line for line in said)
    with pytest.raises(ConfigError, match="no rows of class S at 60 s with 4 satellites"):
        rows_by_cell(replace(sweep, cells=(*sweep.cells, replace(sweep.cells[0], satellites=4))))
    with pytest.raises(ConfigError, match="belong to no cell"):
        rows_by_cell(replace(sweep, cells=sweep.cells[:3]))
    assert "3 satellites" in sweep_text(sweep, lines)


def test_a_tight_filter_may_be_better_than_an_oracle_of_the_gyro(rows: pd.DataFrame) -> None:
    oracle = rows[rows["method"] == "ekf"].assign(method="noise_free_gyro")
    both = pd.concat([rows, oracle], ignore_index=True)
    three, none = (both[both["satellites"] == number].copy() for number in (3, 0))
    assert leak_warnings(three, ["tc_ekf"], resamples=100) == []
    none.loc[none["method"] == "tc_ekf", "max_horizontal_error_m"] *= 0.5
    assert len(leak_warnings(none, ["tc_ekf"], resamples=100)) == 1


def test_two_classes_and_two_lengths_have_a_panel_each(rows: pd.DataFrame, tmp_path: Path) -> None:
    more = [rows.assign(gyro_class=name, duration_s=span) for name in "ST" for span in (60.0, 30.0)]
    table = satellite_table(pd.concat(more), METHODS, ("tc_ekf",), resamples=100)
    order = list(dict.fromkeys(zip(table["gyro_class"], table["duration_s"], strict=True)))
    assert order == [("S", 30.0), ("S", 60.0), ("T", 30.0), ("T", 60.0)]
    assert plot_by_satellites(tmp_path / "a.png", table).stat().st_size > 20_000
