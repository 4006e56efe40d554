"""What filters refused over a drive: every family of filters, and what stands in the results."""

import numpy as np
import pandas as pd
import pytest

from navlearn.experiment.drive import open_log, prepare_drive
from navlearn.experiment.refusals import filters_of, refusals
from navlearn.experiment.run_chapters import run_chapters
from navlearn.logs.synthetic.faults import injected_faults
from navlearn.outages.detection import position_verdicts
from navlearn.outages.known_log import known_log
from navlearn.outages.output import prepare_output_folder
from navlearn.outages.refused_fixes import refused_table
from navlearn.outages.refused_report import Refusals
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe

FAULTS = {
    "spikes": {"sizes_m": [20, 60], "per_hour": 120, "honest": False},
    "apart_s": 30,
    "settle_s": 120,
    "seed": 2,
}
DRIVE = {"profile": "town", "grade": "mems_m", "duration_s": 460, "imu_rate_hz": 20, "seed": 12}


def make(methods, **sections):
    simulated = {**DRIVE, **sections.pop("simulated", {})}
    return Recipe.model_validate(
        {
            "name": "refusing",
            "log": {"simulated": simulated, "faults": FAULTS},
            "methods": list(methods),
            "outages": {"duration_s": 20, "count": 1, "warm_up_s": 60},
            **sections,
        }
    )


@pytest.fixture(scope="module")
def loose():
    recipe = make(("dead_reckoning", "ekf", "ekf+integrity", "rts"), integrity={
        "probability": 1.0, "prediction_limit": 40.0, "robust": "huber"})  # fmt: skip
    log = open_log(recipe)
    return recipe, log, refusals(filters_of(recipe), log)


def test_only_filters_are_asked(loose):
    assert list(loose[2]) == ["ekf", "ekf+integrity"]


def test_large_spikes_are_in_the_table_with_the_reason_of_each_method(loose):
    _, log, found = loose
    faults = injected_faults(log)
    assert len(faults) > 3
    size = np.hypot(faults["east"], faults["north"]).round().to_numpy()
    assert set(size) == {20.0, 60.0}
    reasons = {
        "ekf": {20.0: "refused_by_gate", 60.0: "refused_by_gate"},
        "ekf+integrity": {20.0: "accepted_with_less_weight", 60.0: "refused_by_prediction"},
    }
    for name, reason in reasons.items():
        table = refused_table(found[name].fixes, log)
        spikes = table[(table["kind"] == "position") & (table["fault"] > 0)]
        assert spikes["fault"].tolist() == faults["fault"].tolist()
        assert spikes["verdict"].tolist() == [reason[one] for one in size]
        np.testing.assert_allclose(spikes["t"], faults["t"])
        # the fix is as wrong as the fault put in, but for the receiver's own few metres
        np.testing.assert_allclose(spikes["fix_error_m"], size, atol=8.0)
        np.testing.assert_allclose(spikes["innovation"], size, atol=12.0)
    refused = spikes["verdict"] == "refused_by_prediction"
    assert (spikes.loc[refused, "weight"] == 0.0).all()
    assert set(spikes.loc[refused, "limit_m"]) == {40.0}
    assert spikes.loc[~refused, "weight"].between(0.01, 0.5).all()


def test_the_whole_drive_tells_what_a_scored_method_saw(loose):
    recipe, log, found = loose
    outage = Outage(300.0, 20.0)
    known = refusals({"ekf": filters_of(recipe)["ekf"]}, known_log(log, outage))["ekf"]
    faults = injected_faults(log)
    early = position_verdicts(known.fixes, faults)
    whole = position_verdicts(found["ekf"].fixes, faults)
    whole = whole[whole["t"] < 300.0]
    assert early["t"].tolist() == whole["t"].tolist()
    assert early["verdict"].tolist() == whole["verdict"].tolist()
    np.testing.assert_allclose(early["innovation"], whole["innovation"], atol=1e-4)


def test_a_full_imu_refuses_with_the_same_words():
    recipe = make(("ins_ekf",), mechanization={"sensors": "imu"})
    log = open_log(recipe)
    table = refused_table(refusals(filters_of(recipe), log)["ins_ekf"].fixes, log)
    spikes = table[(table["kind"] == "position") & (table["fault"] > 0)]
    assert sorted(spikes["fault"]) == sorted(injected_faults(log)["fault"])
    assert set(spikes["verdict"]) == {"refused_by_gate"}
    assert (spikes["innovation"] > 8.0).all()


def test_a_tight_filter_names_its_satellites(tmp_path):
    recipe = make(("tc_ekf",), simulated={"satellites": "urban", "duration_s": 300, "seed": 11})
    drive = prepare_drive(recipe)
    one = refusals(filters_of(recipe), drive.log)["tc_ekf"]
    assert isinstance(one, Refusals)
    chapters = run_chapters(recipe, drive, {}, prepare_output_folder(tmp_path / "run", False))
    assert "refused_ranges.csv" in chapters[0].section[1]
    written = pd.read_csv(tmp_path / "run" / "refused_ranges.csv")
    assert len(written) > 0
    assert set(written["satellite"]) <= set(drive.log.ranges["satellite"])
    refused = written[written["verdict"] == "refused_by_gate"]
    assert set(refused["kind"]) <= {"pseudorange", "range_rate"}
    # every refused range is one that was received then
    received = set(zip(drive.log.ranges["t"].round(6), drive.log.ranges["satellite"], strict=True))
    assert set(zip(refused["t"].round(6), refused["satellite"], strict=True)) <= received


def test_the_run_folder_has_it_all(loose, tmp_path):
    recipe, _, _ = loose
    drive = prepare_drive(recipe)
    chapter = run_chapters(recipe, drive, {}, prepare_output_folder(tmp_path / "run", False))[0]
    table = pd.read_csv(tmp_path / "run" / "refused_fixes.csv")
    counts = pd.read_csv(tmp_path / "run" / "refused_counts.csv")
    assert set(table["method"]) == {"ekf", "ekf+integrity"} == set(counts["method"])
    assert set(table["drive"]) == {drive.log.metadata.name}
    refused = table["verdict"].str.startswith("refused").sum()
    assert refused == counts.filter(like="refused").to_numpy().sum()
    assert len(pd.read_csv(tmp_path / "run" / "faults.csv")) == len(injected_faults(drive.log))
    for name in chapter.figures:
        assert (tmp_path / "run" / name).stat().st_size > 5000
    text = "\n".join(chapter.section)
    assert "| ekf | position |" in text
    assert "| ekf | spike |" in text
    assert "none (good)" in text
