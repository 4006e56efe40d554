import csv
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError, FilterDivergedError, MissingExtraError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages import canvas
from navlearn.outages.maps import Scene, plot_drifts, plot_track
from navlearn.outages.markdown import markdown_table
from navlearn.outages.meaning import meaning
from navlearn.outages.naming import axis_label, with_unit
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.placement import place_outages
from navlearn.outages.plots import plot_distribution, plot_error_growth
from navlearn.outages.replay import Solution, join_replays, replay
from navlearn.outages.report import report_text
from navlearn.outages.results import write_results
from navlearn.outages.run_summary import Chapter, DriveSummary, MethodSummary, RunSummary
from navlearn.outages.schedule import Outage, OutageProtocol
from navlearn.outages.statistics import Comparison, compare
from navlearn.outages.tables import write_outages_csv
from navlearn.outages.wording import percent, sentence

MakeLog = Callable[..., DriveLog]
PROTOCOL = OutageProtocol(count=6, duration=30.0)
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class Drifting:
    """Knows the truth and drifts east by so many metres per second, one outage more than others."""

    truth: DriveLog
    drift: float
    worst: int = -1
    fails: int = -1

    def predict(self, log: DriveLog, outage: Outage) -> Solution:
        number = int(log.fixes["t"].iloc[-1])
        if number == self.fails:
            raise FilterDivergedError("the covariance is not finite")
        assert self.truth.reference is not None
        table = self.truth.reference
        table = table[(table["t"] >= outage.start) & (table["t"] <= outage.end)]
        shift = (table["t"] - outage.start) * self.drift * (3.0 if number == self.worst else 1.0)
        lon = table["lon"] + shift / (6.386e6 * np.cos(table["lat"]))
        table = table.assign(lon=lon, std_e=1.0, std_n=1.0, cov_en=0.0)
        return Solution(table=table.drop(columns=["v_u", "pitch", "roll"]))


def run_of(logs: list[DriveLog]) -> tuple[RunSummary, list[Scene]]:
    scenes, drives = [], []
    for log in logs:
        placed = place_outages(PROTOCOL, log)
        methods = {
            "dead_reckoning": Drifting(log, 0.4, fails=int(placed.outages[1].start) - 1),
            "ekf": Drifting(log, 0.2),
            "anarx": Drifting(log, 0.1, worst=int(placed.outages[2].start) - 1),
        }
        done = replay(log, placed.outages, methods, progress=False)
        scenes.append(Scene(log=log, outages=placed.outages, replay=done))
        drives.append(
            DriveSummary(
                name=log.metadata.name,
                source="made",
                duration=log.duration,
                distance=9000.0,
                placement=placed,
                license="CC0",
                judged_by="truth",
            )
        )
    summary = RunSummary(
        title="A made-up run",
        question="Does anarx help?",
        drives=tuple(drives),
        protocol=PROTOCOL,
        methods={
            "dead_reckoning": MethodSummary(description="no updates"),
            "ekf": MethodSummary(description="the baseline"),
            "anarx": MethodSummary(
                description="learned", regime="online", notes=("the safeguard spoke twice",)
            ),
        },
        rows=join_replays([scene.replay for scene in scenes]),
        command="navlearn run training/made.yaml --out runs/made",
        versions={"navlearn": "0.1.0"},
        seeds={"fit": 7},
        remarks=("Simulated.",),
        setup=("The filter's noise was tuned elsewhere.",),
        resamples=500,
    )
    return summary, scenes


@pytest.fixture(scope="module")
def run(make_log: MakeLog) -> tuple[RunSummary, list[Scene]]:
    return run_of([make_log(name="made")])


def test_report_tells_the_whole_story(run: tuple[RunSummary, list[Scene]]) -> None:
    text = report_text(run[0])
    for line in (
        "# A made-up run",
        "> Simulated.",
        "**Question.** Does anarx help?",
        "| method | training | outages | failed | mean | median | 90 % |",
        "| dead_reckoning | none | 6 | 1 | 12.00 | 12.00 | 12.00 |",
        "| ekf | none | 6 | 0 | 6.00 | 6.00 | 6.00 |",
        "| anarx | online | 6 | 0 | 4.00 | 3.00 | 6.00 |",
        "- anarx: the safeguard spoke twice",
        "### Against `ekf`",
        "**Excluded.** Nothing: these rules found nothing bad in any drive.",
        "- Training `online`: learned on this drive, anew for each outage,",
        "- The filter's noise was tuned elsewhere.",
        "The smallest median is that of **anarx** (3.00 m)",
        "**dead_reckoning** failed in 1 of 6 outages",
        "navlearn run training/made.yaml --out runs/made",
        "**Versions.** navlearn 0.1.0.",
        "**Seeds.** fit 7, bootstrap 0.",
        "- made, dead_reckoning, outage 2: the covariance is not finite",
        "6 outages of 30 s per drive, placement `spread`",
        "It tells nothing about other cars",
    ):
        assert line in text, line
    assert "(6 straight), judged by its truth. Licence of the data: CC0." in text
    # anarx: five outages of 3 m and one of 9 m against six of 6 m.
    assert "the mean error of **anarx** is 33 % smaller (improvement +33 %" in text
    assert "It was better in 5 of 6 outages (83 %) and more than 10 % worse in 1." in text
    assert "The 90th percentile is 6.00 m (ekf: 6.00 m)." in text
    assert "| anarx | +33.3 |" in text
    assert "| 3 | 528.0 | straight | 300 | 12.00 | **6.00** | 9.00 |" in text
    assert "| 2 | 414.0 | straight | 300 | – | 6.00 | **3.00** |" in text
    assert "Against `ekf_plain`" not in text


def test_report_names_every_drive_and_warns_that_few_are_few(make_log: MakeLog) -> None:
    summary, _ = run_of([make_log(name="one"), make_log(name="two")])
    text = report_text(summary)
    assert "| one 1 | 300.0 |" in text
    assert "| two 6 | 870.0 |" in text
    assert "no evidence that it helps or harms, because 2 drives are too few" in text
    assert "This rests on 12 outages of 2 drives. A general claim needs" in text


def test_a_chapter_stands_before_the_table_of_every_outage(
    run: tuple[RunSummary, list[Scene]],
) -> None:
    chapter = Chapter(section=("## What it saw\n", "Little.\n"), figures={"saw.png": "The sight."})
    text = report_text(replace(run[0], chapters=(chapter,)))
    places = [text.index(part) for part in ("## What it saw", "](saw.png)", "## Every outage")]
    assert places == sorted(places)
    assert "Little." in text
    assert "*The sight.*" in text


def test_exclusions_are_listed_with_their_reason(
    run: tuple[RunSummary, list[Scene]], make_log: MakeLog
) -> None:
    log = make_log(name="made")
    assert log.reference is not None
    table = log.reference
    holed = replace(log, reference=table[(table["t"] < 700.0) | (table["t"] > 720.0)])
    drive = replace(run[0].drives[0], placement=place_outages(PROTOCOL, holed))
    text = report_text(replace(run[0], drives=(drive,)))
    assert "| made | 699.9 | 720.1 | no truth for 20.2 s |" in text


def test_all_files_are_written_and_agree(
    run: tuple[RunSummary, list[Scene]], tmp_path: Path
) -> None:
    output = prepare_output_folder(tmp_path / "run")
    summary = write_results(output, *run)
    folder = output.path
    with (folder / "outages.csv").open(encoding="utf-8", newline="") as file:
        rows = pd.DataFrame(csv.DictReader(file))  # as text: pandas may round the last digit
    assert list(rows.columns[:7]) == [
        "drive", "method", "outage", "start_s", "duration_s", "dynamics", "distance_m"
    ]  # fmt: skip
    for name in ("max_horizontal_error_m", "final_cross_track_error_m"):
        values = [float(text) if text else np.nan for text in rows[name]]
        assert np.array_equal(values, run[0].rows[name], equal_nan=True)
    content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    found = content["methods"]["anarx"]
    assert found["training_regime"] == "online"
    assert found["figures"]["max_horizontal_error_m"]["mean"] == pytest.approx(4.0, rel=1e-3)
    assert found["versus"]["ekf"]["harm_count"] == 1
    assert content["methods"]["dead_reckoning"]["failed"] == 1
    assert content["drives"][0]["outages"] == 6
    assert content["protocol"]["placement"] == "spread"
    assert "NaN" not in (folder / "summary.json").read_text(encoding="utf-8")
    report = (folder / "report.md").read_text(encoding="utf-8")
    assert set(summary.figures) == {
        "track.png", "drifts.png", "error_growth.png", "distribution.png"
    }  # fmt: skip
    for file in summary.figures:
        picture = (folder / file).read_bytes()
        assert picture.startswith(PNG)
        assert len(picture) > 5000
        assert f"]({file})" in report


def test_without_matplotlib_all_but_the_figures_is_written(
    run: tuple[RunSummary, list[Scene]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'navlearn\[report\]'"):
        canvas.new_figure(1.0, 1.0)
    output = prepare_output_folder(tmp_path / "run")
    with pytest.warns(UserWarning, match="matplotlib is missing"):
        write_results(output, *run)
    assert not list(output.path.glob("*.png"))
    assert "navlearn[report]" in (output.path / "report.md").read_text(encoding="utf-8")


def test_figures_leave_pyplot_alone(run: tuple[RunSummary, list[Scene]], tmp_path: Path) -> None:
    scene = run[1][0]
    before = set(sys.modules)
    files = [
        plot_track(tmp_path / "a.png", scene),
        plot_drifts(tmp_path / "b.png", scene, most=3),
        plot_error_growth(tmp_path / "c.png", [scene.replay, scene.replay]),
        plot_distribution(tmp_path / "d.png", run[0].rows, "share_in_95_ellipse"),
    ]
    assert all(file.read_bytes().startswith(PNG) for file in files)
    assert "matplotlib.pyplot" not in set(sys.modules) - before


def test_figures_of_one_outage_without_reference_are_drawn(
    make_log: MakeLog, tmp_path: Path
) -> None:
    log = make_log(name="made")
    bare = replace(log, reference=None)
    outage = [Outage(400.0, 30.0)]
    done = replay(bare, outage, {"ekf": Drifting(log, 0.0)}, progress=False)
    scene = Scene(log=bare, outages=outage, replay=done)
    for file in (
        plot_track(tmp_path / "a.png", scene),
        plot_drifts(tmp_path / "b.png", scene),
        plot_error_growth(tmp_path / "c.png", [done]),
        plot_distribution(tmp_path / "d.png", done.rows),
    ):
        assert file.read_bytes().startswith(PNG)


def test_rows_that_lack_promised_columns_are_not_written(
    run: tuple[RunSummary, list[Scene]], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=r"lack \['distance_m'\]"):
        write_outages_csv(tmp_path / "outages.csv", run[0].rows.drop(columns="distance_m"))


def compared(ours: list[float], theirs: list[float]) -> Comparison:
    rows = [
        {"drive": "made", "method": method, "outage": k, "max_horizontal_error_m": error}
        for method, errors in (("ours", ours), ("theirs", theirs))
        for k, error in enumerate(errors)
    ]
    return compare(pd.DataFrame(rows), "ours", "theirs", resamples=500)


TEN = [5.0, 7.0, 6.0, 8.0, 5.0, 9.0, 6.0, 7.0, 5.0, 8.0]
CLOSE = [0.99, 1.0, 1.01, 0.98, 1.0, 1.0, 1.01, 1.0, 0.98, 1.005]
MIXED = [0.9, 1.1, 0.8, 1.2, 1.0, 0.9, 1.1, 1.0, 0.95, 1.05]


@pytest.mark.parametrize(
    ("factors", "learned", "as_baseline"),
    [
        ([1.02] * 10, "it harms in these outages", "it is worse in these outages"),
        (CLOSE, "it is harmless in these outages, because the whole", "it is no worse in these"),
        ([0.5] * 10, "it helps in these outages", "it is better in these outages"),
        ([3.5] * 10, "it harms in these outages", "it is worse in these outages"),
        (MIXED, "no evidence that it helps or harms", "no evidence of a difference"),
        ([1.0] * 10, "it never acted", "equals **theirs** in all 10 outages."),
        ([0.5] * 9 + [np.nan], "because it failed in 1 that", "because it failed in 1 that"),
        ([0.5] * 3, "3 outages are too few", "3 outages are too few"),
        ([np.nan] * 2, "share no outage", "share no outage"),
        ([0.5], "(improvement +50 %, no interval)", "one outage is too few"),
        ([1.0], "in the only outage: it never acted", "in the only outage."),
    ],
)
def test_what_is_said_of_learned_methods_and_of_baselines(
    factors: list[float], learned: str, as_baseline: str
) -> None:
    theirs = TEN[: len(factors)]
    found = compared([f * e for f, e in zip(factors, theirs, strict=True)], theirs)
    assert learned in sentence("ours", "theirs", found, learned=True)
    said = sentence("ours", "theirs", found)
    assert as_baseline in said
    assert "helps" not in said
    assert "harms" not in said


def test_sizes_are_told_as_one_would_say_them() -> None:
    much = sentence("a", "b", compared([4.0 * e for e in TEN], TEN))
    assert "4.0 times as large (improvement −300 %" in much
    assert "25 % larger" in sentence("a", "b", compared([1.25 * e for e in TEN], TEN))


def test_a_gain_that_the_filter_has_alone_is_not_the_models(
    run: tuple[RunSummary, list[Scene]],
) -> None:
    rows = run[0].rows
    plain = rows[rows["method"] == "ekf"].assign(method="ekf_plain")
    plain["max_horizontal_error_m"] *= 10.0
    gated = rows[rows["method"] == "ekf"].assign(method="anarx")
    rows = pd.concat([rows[rows["method"] != "anarx"], plain, gated])
    methods = {**run[0].methods, "ekf_plain": MethodSummary(description="no bias")}
    lines = meaning(replace(run[0], rows=rows, methods=methods))
    assert lines[0].startswith(
        "**anarx: harmless (never acted).** **anarx** equals **ekf** in all 6 outages: it never"
    )
    assert lines[1].endswith(
        "But **ekf** alone gains +90 % there: this is no merit of what was learned."
    )
    text = report_text(replace(run[0], rows=rows, methods=methods))
    assert "| 0 | harmless (never acted) |" in text
    assert "| 6 of 6 | 0.031 | 0 | better |" in text


def test_figures_have_names_in_words_and_units() -> None:
    assert axis_label("max_horizontal_error_m") == "maximum horizontal error (m)"
    assert axis_label("rms_velocity_error_m_per_s") == "RMS velocity error (m/s)"
    assert axis_label("share_in_95_ellipse") == "share in 95 % ellipse"
    assert with_unit(3.936, "max_azimuth_error_deg") == "3.94 °"
    assert with_unit(0.5, "share_in_95_ellipse") == "0.50"


def test_small_wording() -> None:
    assert percent(0.0) == percent(-0.04) == "0 %"
    assert percent(-33.4) == "−33 %"
    assert percent(0.4) == "+0.4 %"
    assert markdown_table(("a", "b"), [("x", "1")]) == "| a | b |\n| --- | ---: |\n| x | 1 |\n"
