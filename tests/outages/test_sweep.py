import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.published import PublishedTable
from navlearn.outages.run_summary import MethodSummary
from navlearn.outages.statistics import compare
from navlearn.outages.sweep_plots import plot_improvements
from navlearn.outages.sweep_report import rows_by_cell, table_of, write_sweep_report
from navlearn.outages.sweep_summary import SweepCell, SweepSummary
from navlearn.outages.sweep_tables import cell_markdown, overview_markdown, sweep_table
from navlearn.outages.sweep_text import sweep_text
from navlearn.outages.sweep_wording import sweep_meaning, sweep_warnings

METHODS = {
    "ekf": MethodSummary(description="the baseline"),
    "augmented": MethodSummary(description="states", regime="online", notes=("13 states",)),
    "idle": MethodSummary(description="a gate that never opens", regime="online"),
    "iqbal2020_raw": MethodSummary(description="as printed", regime="online", guarded=False),
    "rts": MethodSummary(description="smoothed", regime="post-processing"),
    "oracle": MethodSummary(description="knows the errors", regime="oracle"),
    "noise_free_gyro": MethodSummary(description="knows more", regime="oracle"),
}
FACTORS = {
    "ekf": 1.0,
    "augmented": 0.7,
    "idle": 1.0,
    "iqbal2020_raw": 3.4,
    "rts": 0.3,
    "oracle": 0.6,
    "noise_free_gyro": 0.5,
}
CLASSES = ("M", "L")


USED = {"augmented": True, "idle": False, "iqbal2020_raw": True}
Errors = Callable[[str, float], pd.DataFrame]


@pytest.fixture(scope="module")
def errors(make_rows: Callable[..., pd.DataFrame]) -> Errors:
    """Eight drives of five outages of one cell."""

    def of(gyro_class: str, duration: float) -> pd.DataFrame:
        rows = make_rows(
            FACTORS,
            USED,
            drives=tuple(f"{gyro_class}_{k}" for k in range(8)),
            outages=5,
            duration=duration,
            seed=CLASSES.index(gyro_class) + int(duration),
        )
        return rows.assign(gyro_class=gyro_class)

    return of


@pytest.fixture(scope="module")
def sweep(errors: Errors) -> SweepSummary:
    parts = [errors(gyro_class, duration) for gyro_class in CLASSES for duration in (60.0, 120.0)]
    return SweepSummary(
        title="Honest comparison",
        question="Who helps?",
        rows=pd.concat(parts, ignore_index=True),
        cells=tuple(
            SweepCell(
                gyro_class=gyro_class,
                duration=duration,
                drives=tuple(f"{gyro_class}_{k}" for k in range(8)),
                remark="made for a test",
            )
            for gyro_class in ("L", "M")
            for duration in (60.0, 120.0)
        ),
        methods=METHODS,
        command="navlearn sweep",
        versions={"navlearn": "0.1.0"},
        seeds={"drives": 100},
        classes={"L": "2.25 °/√h"},
        published=(
            PublishedTable(
                source="Shen2010",
                caption="Maximum horizontal error, Table 2",
                columns=("outage", "KF m", "FOS m"),
                rows=(("1", 78.1, 26.31), ("mean", 5, -1.5)),
                remark="another drive, other sensors: the two do not compare",
            ),
        ),
        remarks=("Simulated.",),
        setup=("Tuned elsewhere.",),
        wall_clock=4325.0,
        processes=2,
        resamples=500,
    )


@pytest.fixture(scope="module")
def table(sweep: SweepSummary) -> pd.DataFrame:
    return table_of(replace(sweep, rows=rows_by_cell(sweep)))


def test_the_table_has_a_line_per_cell_and_method(sweep: SweepSummary, table: pd.DataFrame) -> None:
    assert len(table) == 4 * len(METHODS)
    assert list(dict.fromkeys(zip(table["gyro_class"], table["duration_s"], strict=True))) == [
        ("L", 60.0), ("L", 120.0), ("M", 60.0), ("M", 120.0)
    ]  # fmt: skip
    assert table["method"].tolist()[: len(METHODS)] == list(METHODS)


def test_each_line_agrees_with_its_own_outages(errors: Errors, table: pd.DataFrame) -> None:
    lines = table.set_index(["gyro_class", "duration_s", "method"])
    for gyro_class in CLASSES:
        rows = errors(gyro_class, 120.0)
        wide = rows.pivot_table(
            index=["drive", "outage"], columns="method", values="max_horizontal_error_m"
        )
        means = wide.mean()
        line = lines.loc[(gyro_class, 120.0, "augmented")]
        assert line["mean"] == pytest.approx(means["augmented"])
        assert line["p90"] == pytest.approx(np.percentile(wide["augmented"], 90))
        gain = 100.0 * (1.0 - means["augmented"] / means["ekf"])
        assert line["improvement_percent"] == pytest.approx(gain)
        share = (means["ekf"] - means["augmented"]) / (means["ekf"] - means["oracle"])
        assert line["oracle_share_percent"] == pytest.approx(100.0 * share)
        assert line["oracle_share_low_percent"] < 100.0 * share < line["oracle_share_high_percent"]
        assert (line["drives"], line["outages"], line["units"]) == (8, 40, 8)
        assert (line["acted"], line["asked"]) == (40, 40)
        one = compare(rows, "augmented", "ekf", resamples=500)
        assert line["low_percent"] == one.low_percent
        assert line["harm_count"] == one.harm_count
        assert line["wins"] == (wide["augmented"] < wide["ekf"]).sum()


def test_verdicts_and_roles_of_the_lines(table: pd.DataFrame) -> None:
    part = table[(table["gyro_class"] == "L") & (table["duration_s"] == 60.0)]
    found = part.set_index("method")
    assert found["verdict"].dropna().to_dict() == {
        "augmented": "helps", "idle": "harmless", "iqbal2020_raw": "harms", "rts": "helps",
        "oracle": "helps", "noise_free_gyro": "helps",
    }  # fmt: skip
    assert found["role"].to_dict() == {
        "ekf": "baseline", "augmented": "learned", "idle": "learned",
        "iqbal2020_raw": "learned", "rts": "post-processing", "oracle": "oracle",
        "noise_free_gyro": "oracle",
    }  # fmt: skip
    assert found.loc[["ekf", "oracle"], "oracle_share_percent"].isna().all()
    assert found.loc["idle", "oracle_share_percent"] == 0.0
    text = cell_markdown(part)
    assert "| idle | harmless (never acted) |" in text
    assert "| 0 of 40 | 0 (0 to 0) | 40 | 0 |" in text
    assert "| ekf | – |" in text
    assert "| oracle | better |" in text


def test_what_is_said_of_classes_papers_and_the_safeguard(
    sweep: SweepSummary, table: pd.DataFrame
) -> None:
    lines = sweep_meaning(sweep, table)
    assert lines[0].startswith("**Class L (2.25 °/√h), 60 s** (40 outages of 8 drives; **ekf** is")
    assert "helps: **augmented** +" in lines[0]
    assert "harmless: **idle** (never acted); harms: **iqbal2020_raw** −2" in lines[0]
    assert " % of the oracle's gain); harmless:" in lines[0]
    assert "no evidence: none." in lines[0]
    assert "With what came after, rts +" in lines[0]
    assert "Bounds: oracle +" in lines[0]
    assert sum(line.startswith("**Class") for line in lines) == 4
    paper = next(line for line in lines if "own version" in line)
    assert "iqbal2020_raw**, without a safeguard: L 60 s harms (−2" in paper
    assert "M 120 s harms" in paper
    holds = lines[-1]
    assert holds.startswith("**The safeguard holds**: no safeguarded method is worse than −3 %")
    assert "**idle** in L 60 s with 0 %" in holds


def test_a_safeguard_that_does_not_hold_is_named(sweep: SweepSummary, table: pd.DataFrame) -> None:
    methods = {**METHODS, "iqbal2020_raw": replace(METHODS["iqbal2020_raw"], guarded=True)}
    lines = sweep_meaning(replace(sweep, methods=methods), table)
    assert lines[-1].startswith("**The safeguard does not hold**: worse than −3 % on the mean")
    assert "**iqbal2020_raw** in L 60 s (−2" in lines[-1]
    assert " %), M 120 s (−2" in lines[-1]
    assert "augmented" not in lines[-1]


def test_a_gain_above_the_noise_free_gyro_is_a_warning(sweep: SweepSummary) -> None:
    assert sweep_warnings(sweep) == []
    rows = sweep.rows.copy()
    cheats = (rows["method"] == "augmented") & (rows["gyro_class"] == "M")
    rows.loc[cheats, "max_horizontal_error_m"] *= 0.4
    lines = sweep_warnings(replace(sweep, rows=rows))
    assert len(lines) == 2
    assert lines[0].startswith("**Warning.** Class M, 60 s: **augmented** is better than")
    assert "the interval excludes chance" in lines[0]
    cheating = replace(sweep, rows=rows_by_cell(replace(sweep, rows=rows)))
    text = sweep_text(cheating, table_of(cheating))
    assert "> **Warning.** Class M, 60 s: **augmented**" in text
    assert "rts** is better" not in text


def test_a_class_where_the_oracle_gains_nothing_has_no_shares(sweep: SweepSummary) -> None:
    rows = sweep.rows.copy()
    useless = (rows["method"] == "oracle") & (rows["gyro_class"] == "L")
    rows.loc[useless, "max_horizontal_error_m"] /= 0.6
    lines = sweep_meaning(sweep, sweep_table(rows, METHODS, resamples=200))
    told = [line for line in lines if "The oracle's own gain is not clear of zero" in line]
    assert [line.startswith("**Class L") for line in told] == [True, True]
    assert not any("of the oracle's gain" in line for line in told)


def test_too_few_drives_are_not_taken_for_a_useless_oracle(sweep: SweepSummary) -> None:
    rows = sweep.rows[sweep.rows["drive"].str.endswith(("_1", "_2"))]
    lines = sweep_meaning(sweep, sweep_table(rows, METHODS, resamples=200))
    told = [line for line in lines if line.startswith("**Class")]
    assert told
    assert all("rests on fewer than 6 drives" in line for line in told)
    assert not any("not clear of zero" in line for line in lines)


def test_failures_are_told_and_forbid_a_good_verdict(sweep: SweepSummary) -> None:
    rows = sweep.rows.copy()
    lost = (rows["method"] == "augmented") & (rows["drive"] == "L_3") & (rows["outage"] == 2)
    rows.loc[lost & (rows["duration_s"] == 60.0), "max_horizontal_error_m"] = np.nan
    failed = replace(sweep, rows=rows)
    table = table_of(replace(failed, rows=rows_by_cell(failed)))
    line = table.set_index(["gyro_class", "duration_s", "method"]).loc[("L", 60.0, "augmented")]
    assert (line["failed"], line["failed_alone"], line["verdict"]) == (1, 1, "no evidence")
    assert "**augmented** in L 60 s 1 of 40" in sweep_meaning(failed, table)[-1]


def test_drives_without_outages_are_named(sweep: SweepSummary, table: pd.DataFrame) -> None:
    more = replace(sweep.cells[0], drives=(*sweep.cells[0].drives, "L_99"))
    text = sweep_text(replace(sweep, cells=(more, *sweep.cells[1:])), table)
    assert text.count("No outage of") == 1
    assert "9 drives: L_0, L_1, L_2, L_3, L_4, L_5, L_6, L_7, L_99. No outage of L_99 was" in text


def test_the_files_of_a_sweep(sweep: SweepSummary, tmp_path: Path) -> None:
    output = prepare_output_folder(tmp_path / "sweep")
    written = write_sweep_report(output, sweep)
    names = ("outages.csv", "cells.csv", "summary.json", "improvement.png", "report.md")
    assert all((output.path / name).is_file() for name in names)
    assert set(written.figures) == {"improvement.png"}
    back = pd.read_csv(output.path / "cells.csv")
    assert back["gyro_class"].tolist()[0] == "L"
    again = sweep_table(pd.read_csv(output.path / "outages.csv"), METHODS, resamples=500)
    np.testing.assert_allclose(again["low_percent"], back["low_percent"], rtol=1e-9)
    assert again["acted"].sum() == back["acted"].sum() == 2 * 160
    content = json.loads((output.path / "summary.json").read_text(encoding="utf-8"))
    assert content["lines"][1]["method"] == "augmented"
    assert content["lines"][0]["verdict"] is None
    assert content["published"][0]["rows"][0] == ["1", 78.1, 26.31]
    assert content["wall_clock_s"] == 4325.0
    text = (output.path / "report.md").read_text(encoding="utf-8")
    for line in (
        "# Honest comparison",
        "> Simulated.",
        "## What this means",
        "| method | L, 60 s | L, 120 s | M, 60 s | M, 120 s |",
        "![Improvement of the mean error",
        "### L, 120 s",
        "2.25 °/√h. Made for a test. 8 drives: L_0, L_1,",
        "Post-processing, which knows what came after:",
        "Oracles, which know what no car can:",
        "## The paper's table",
        "**[Shen2010]** Maximum horizontal error, Table 2. *another drive, other sensors: the two",
        "| mean | 5 | −1.5 |",
        "- augmented: 13 states",
        "### What the safeguard said",
        "| idle | stood back | gate: +1 to +5 % | 160 |",
        "- Tuned elsewhere.",
        "**Time.** 1 h 12 min in 2 processes.",
        "**Seeds.** drives 100, bootstrap 0.",
    ):
        assert line in text, line
    assert "NaN" not in text


def test_rows_and_cells_must_go_together(sweep: SweepSummary) -> None:
    with pytest.raises(ConfigError, match="no rows of class T at 60 s"):
        rows_by_cell(replace(sweep, cells=(*sweep.cells, replace(sweep.cells[0], gyro_class="T"))))
    with pytest.raises(ConfigError, match="some rows belong to no cell"):
        rows_by_cell(replace(sweep, cells=sweep.cells[:2]))
    with pytest.raises(ConfigError, match=r"lack \['gyro_class'\]"):
        rows_by_cell(replace(sweep, rows=sweep.rows.drop(columns="gyro_class")))
    with pytest.raises(ConfigError, match=r"the methods \['idle'\], of which nothing is told"):
        sweep_table(sweep.rows, {k: v for k, v in METHODS.items() if k != "idle"})
    with pytest.raises(ConfigError, match="class M at 60 s has no method 'ukf'"):
        sweep_table(sweep.rows, METHODS, baseline="ukf")
    with pytest.raises(ConfigError, match=r"lack the columns \['outage'\]"):
        sweep_table(sweep.rows.drop(columns="outage"), METHODS)


def test_cells_without_an_oracle_or_a_method_are_told_as_such(
    sweep: SweepSummary, tmp_path: Path
) -> None:
    rows = sweep.rows
    bare = rows[~((rows["gyro_class"] == "M") & rows["method"].isin(["oracle", "idle"]))]
    table = sweep_table(bare, METHODS, resamples=200)
    lines = table.set_index(["gyro_class", "duration_s", "method"])
    assert np.isnan(lines.loc[("M", 60.0, "augmented"), "oracle_share_percent"])
    why = lines.loc[("M", 60.0, "augmented"), "oracle_share_unknown_because"]
    assert why == "there is no `oracle` to measure by"
    text = overview_markdown(table)
    assert "| method | M, 60 s | M, 120 s | L, 60 s | L, 120 s |" in text
    assert "| idle |  |  | 0.0 (0.0 to 0.0) |" in text.replace("+0.0", "0.0")
    one_cell = table[(table["gyro_class"] == "L") | (table["duration_s"] == 60.0)]
    assert plot_improvements(tmp_path / "a.png", one_cell).stat().st_size > 5000
