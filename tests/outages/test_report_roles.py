"""What a report says of oracles, post-processing, safeguards and the tables of papers."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.outages.canvas import GREYS, styles
from navlearn.outages.meaning import meaning, oracle_shares, run_warnings
from navlearn.outages.method_table import method_table
from navlearn.outages.plots import plot_distribution
from navlearn.outages.published import PublishedTable
from navlearn.outages.report import report_text
from navlearn.outages.roles import ORACLES, having, real_time
from navlearn.outages.run_summary import DriveSummary, MethodSummary, RunSummary
from navlearn.outages.schedule import Outage, OutageProtocol, Placement
from navlearn.outages.tables import summary_content, write_summary_json

METHODS = {
    "noise_free_gyro": MethodSummary(description="an error-free gyro", regime="oracle"),
    "oracle": MethodSummary(description="knows the errors", regime="oracle"),
    "rts": MethodSummary(description="smoothed", regime="post-processing"),
    "ekf": MethodSummary(description="the baseline"),
    "ekf_plain": MethodSummary(description="no bias"),
    "augmented": MethodSummary(description="states", regime="online"),
    "shen2010": MethodSummary(description="as printed", regime="online", guarded=False),
}
FACTORS = {
    "ekf": 1.0, "noise_free_gyro": 0.5, "oracle": 0.6, "rts": 0.3, "ekf_plain": 3.0,
    "augmented": 0.7, "shen2010": 3.4,
}  # fmt: skip
DRIVES = tuple(f"drive_{k}" for k in range(7))
TABLE = PublishedTable(
    source="Shen2010",
    caption="Maximum horizontal error",
    columns=("outage", "KF m", "FOS m"),
    rows=(("1", 78.1, 26.31),),
    remark="another drive, other sensors: the two do not compare",
)


@pytest.fixture(scope="module")
def run(make_rows: Callable[..., pd.DataFrame]) -> RunSummary:
    placed = Placement(
        outages=tuple(Outage(100.0 * k, 60.0) for k in range(1, 5)), dynamics=("turn",) * 4
    )
    return RunSummary(
        title="Who plays which part",
        question="Is it told?",
        drives=tuple(
            DriveSummary(name=name, source="", duration=900.0, distance=1e4, placement=placed)
            for name in DRIVES
        ),
        protocol=OutageProtocol(count=4),
        methods=METHODS,
        rows=make_rows(
            FACTORS, {"augmented": True, "shen2010": True}, drives=DRIVES, outages=4, seed=3
        ),
        command="navlearn run",
        versions={"navlearn": "0.1.0"},
        published=(TABLE,),
        resamples=500,
    )


def test_the_paragraph_of_a_learned_method_tells_everything(run: RunSummary) -> None:
    lines = meaning(run)
    wide = run.rows.pivot_table(
        index=["drive", "outage"], columns="method", values="max_horizontal_error_m"
    )
    means = wide.mean()
    gain = 100.0 * (1.0 - means["augmented"] / means["ekf"])
    share = 100.0 * (means["ekf"] - means["augmented"]) / (means["ekf"] - means["oracle"])
    wins = int((wide["augmented"] < wide["ekf"]).sum())
    assert lines[0].startswith("**augmented: helps.** Against **ekf**, the mean error of")
    for said in (
        f"(improvement +{gain:.0f} %, 95 % interval +",
        f"It was better in {wins} of 28 outages (100 %) and more than 10 % worse in 0.",
        f"The 90th percentile is {np.percentile(wide['augmented'], 90):.2f} m "
        f"(ekf: {np.percentile(wide['ekf'], 90):.2f} m).",
        "The safeguard let it act in 28 of 28 outages.",
        f"Of what the oracle gains over **ekf** it reached {share:.0f} % (95 % interval ",
    ):
        assert said in lines[0], said
    assert lines[2].startswith("**shen2010: harms.**")
    assert "Unguarded, it acted in 28 of 28 outages." in lines[2]
    assert "it reached −" in lines[2]


def test_bounds_and_smoothers_are_never_the_best(run: RunSummary) -> None:
    lines = meaning(run)
    best = next(line for line in lines if "smallest median" in line)
    assert best.startswith("Of the methods that run while the car drives, the smallest median is")
    assert "that of **augmented** (" in best
    assert "rts" not in best
    assert "oracle" not in best
    of_rts = next(line for line in lines if "mean error of **rts**" in line)
    assert "it is better in these outages" in of_rts
    assert of_rts.endswith("It knows what came after the outage, so it is no competitor.")
    of_oracle = next(line for line in lines if "mean error of **oracle**" in line)
    assert of_oracle.endswith("It is an oracle: it knows what no car can, and only marks a bound.")
    assert real_time(run.methods) == ["ekf", "ekf_plain", "augmented", "shen2010"]
    assert having(run.methods, "oracle") == ["noise_free_gyro", "oracle"]


def test_oracles_and_smoothers_have_tables_of_their_own(run: RunSummary) -> None:
    text = report_text(run)
    section = text[text.index("### Against `ekf`") : text.index("### Against `ekf_plain`")]
    competing, rest = section.split("Post-processing, which knows what came after")
    post, oracles = rest.split("Oracles, which know what no car can")
    names = [re.findall(r"^\| (\w+) \|", part, re.MULTILINE) for part in (competing, post, oracles)]
    assert names == [
        ["method", "ekf_plain", "augmented", "shen2010"],
        ["method", "rts"],
        ["method", "noise_free_gyro", "oracle"],
    ]
    assert "share of oracle %" in section
    assert "It is harmless where all of the interval lies above −3 %" in section
    assert "- Training `oracle`: nothing is learned, but what no car can know is seen" in text
    outages = text[text.index("## Every outage") :]
    header, _, *lines = [line for line in outages.splitlines() if line.startswith("|")]
    cells = [cell.strip() for cell in header.strip("|").split("|")]
    assert cells[-3:] == ["rts", "noise_free_gyro", "oracle"]
    for line in lines:
        bold = [name for name, cell in zip(cells, line.strip("|").split("|"), strict=True)
                if "**" in cell]  # fmt: skip
        assert bold == ["augmented"]


def test_reasons_of_the_safeguard_and_tables_of_papers_are_shown(run: RunSummary) -> None:
    text = report_text(run)
    assert "### What the safeguard said" in text
    assert "| augmented | acted | gate: +1 to +4 % | 28 |" in text
    assert "## The paper's table\n\n**[Shen2010]** Maximum horizontal error. *another" in text
    assert "| 1 | 78.1 | 26.31 |" in text
    assert text.index("## Methods side by side") < text.index("## The paper's table")
    both = replace(run, published=(TABLE, replace(TABLE, source="Iqbal2020", remark="")))
    assert "## The papers' tables" in report_text(both)
    assert "The paper's table" not in report_text(replace(run, published=()))


def test_published_rows_have_a_cell_for_every_column() -> None:
    with pytest.raises(ConfigError, match="Shen2010: row 2 has 2 cells, but there are 3 columns"):
        replace(TABLE, rows=(*TABLE.rows, ("2", 1.0)))
    with pytest.raises(ConfigError, match="no columns"):
        replace(TABLE, columns=(), rows=())


def test_the_summary_file_tells_parts_shares_and_reasons(run: RunSummary, tmp_path: Path) -> None:
    path = write_summary_json(tmp_path / "summary.json", run)
    content = json.loads(path.read_text(encoding="utf-8"))
    methods = content["methods"]
    assert {name: one["role"] for name, one in methods.items()} == {
        "noise_free_gyro": "oracle", "oracle": "oracle", "rts": "post-processing",
        "ekf": "baseline", "ekf_plain": "baseline", "augmented": "learned", "shen2010": "learned",
    }  # fmt: skip
    shares = oracle_shares(run)
    assert methods["augmented"]["share_of_oracle"]["share_percent"] == pytest.approx(
        shares["augmented"].share_percent
    )
    assert methods["oracle"]["share_of_oracle"] is None
    assert methods["augmented"]["safeguard"] == {
        "acted": 28,
        "asked": 28,
        "reasons": [{"used": True, "outages": 28, "reason": "gate: +1 to +4 %"}],
    }
    assert methods["ekf"]["safeguard"] is None
    assert content["warnings"] == []
    assert content["published"][0]["source"] == "Shen2010"
    table = method_table(run.rows, resamples=500).set_index("method")
    assert table.loc["augmented", "oracle_share_percent"] == shares["augmented"].share_percent
    assert np.isnan(table.loc["oracle", "oracle_share_percent"])


def test_a_gain_above_the_noise_free_gyro_is_warned_of_first(run: RunSummary) -> None:
    assert run_warnings(run) == []
    rows = run.rows.copy()
    rows.loc[rows["method"] == "augmented", "max_horizontal_error_m"] *= 0.5
    leaky = replace(run, rows=rows)
    (line,) = run_warnings(leaky)
    assert line.startswith("**Warning.** **augmented** is better than **noise_free_gyro** (")
    assert "a gain above an oracle points to a leak or a bug" in line
    text = report_text(leaky)
    assert text.index("> **Warning.**") < text.index("**Question.**")
    assert f"- {line}" in text
    assert summary_content(leaky)["warnings"] == [line.replace("**", "")]
    without = {name: about for name, about in METHODS.items() if name != "noise_free_gyro"}
    bare = replace(leaky, methods=without, rows=rows[rows["method"] != "noise_free_gyro"])
    assert run_warnings(bare) == []


def test_a_share_that_means_nothing_is_not_told(run: RunSummary) -> None:
    rows = run.rows.copy()
    mine = rows["method"] == "oracle"
    base = rows.loc[rows["method"] == "ekf", "max_horizontal_error_m"].to_numpy()
    wobble = np.where(np.arange(base.size) % 2 == 0, 0.8, 1.2)
    rows.loc[mine, "max_horizontal_error_m"] = base * wobble
    lines = meaning(replace(run, rows=rows))
    assert "cannot be told: the oracle's own gain is not clear of zero." in lines[0]
    text = report_text(replace(run, rows=rows))
    section = text[text.index("### Against `ekf`") :]
    assert re.search(r"^\| augmented \|.*\| helps \| – \|$", section, re.MULTILINE)


def test_figures_tell_many_methods_apart_and_draw_oracles_grey(
    run: RunSummary, tmp_path: Path
) -> None:
    names = [*(f"method {k}" for k in range(16)), *ORACLES]
    look = styles(names)
    assert list(look) == names
    assert len(set(look.values())) == len(names)
    for name in ORACLES:
        color, dash = look[name]
        assert color in GREYS
        assert dash != "-"
    assert not {look[name][0] for name in names[:16]} & set(GREYS)
    assert styles(["oracle", "ekf"])["ekf"] == styles(["ekf"])["ekf"]
    path = plot_distribution(tmp_path / "a.png", run.rows)
    assert path.stat().st_size > 5000
