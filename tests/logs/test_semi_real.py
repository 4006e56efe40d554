"""Aiding made from a reference, beside what a simulator made of the motion itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn.errors import ConfigError, LogError
from navlearn.frames import enu_between
from navlearn.logs.formats.native import load_log, save_log
from navlearn.logs.reading import read_log
from navlearn.logs.reference import reference_at
from navlearn.logs.resample import riss_timeline
from navlearn.logs.synthetic import simulate_drive, with_aiding_from_reference
from navlearn.logs.synthetic.figures import GnssGrade, OdometerGrade

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
ARM = (0.4, -0.8, 1.2)
EXACT = {"gnss": GnssGrade(), "odometer": OdometerGrade()}


@pytest.fixture(scope="module")
def drive():
    return simulate_drive(
        profile="town", grade="ideal", duration=120.0, seed=11, imu_rate_hz=20.0, lever_arm=ARM,
        standstill=5.0,
    ).log  # fmt: skip


def apart(table, other):
    places = [[torch.tensor(x[c].to_numpy()) for c in ("lat", "lon", "height")]
              for x in (table, other)]  # fmt: skip
    return np.stack([x.numpy() for x in enu_between(*places[0], *places[1])], axis=-1)


def test_without_errors_it_is_what_the_simulator_makes(drive):
    made = with_aiding_from_reference(drive, lever_arm=ARM, **EXACT)
    kept = drive.fixes.iloc[1:-1].reset_index(drop=True)
    found = made.fixes[made.fixes["t"].isin(kept["t"])].reset_index(drop=True)
    assert len(found) == len(kept)
    assert np.abs(apart(found, kept)).max() < 0.005
    velocities = ["v_e", "v_n", "v_u"]
    np.testing.assert_allclose(found[velocities], kept[velocities], atol=0.02)
    np.testing.assert_allclose(
        made.odometer["speed"], drive.odometer["speed"].iloc[: len(made.odometer)], atol=0.05
    )
    # The arm matters: without it the antenna is a metre off.
    bare = with_aiding_from_reference(drive, **EXACT)
    rest = bare.fixes[bare.fixes["t"].isin(kept["t"])].reset_index(drop=True)
    size = np.linalg.norm(apart(rest, kept), axis=1)
    np.testing.assert_allclose(size, np.linalg.norm(ARM), atol=0.01)


def test_errors_have_the_stated_size_and_latency_its_sense(drive):
    gnss = GnssGrade(noise=2.0, velocity_noise=0.3, latency=0.5)
    wheels = OdometerGrade(noise=0.2, latency=0.2)
    made = with_aiding_from_reference(
        drive, fix_rate_hz=10.0, gnss=gnss, odometer=wheels, lever_arm=ARM, seed=3
    )
    assert (made.metadata.gnss_latency, made.metadata.odometer_latency) == (0.5, 0.2)
    assert made.metadata.lever_arm == ARM
    exact = with_aiding_from_reference(drive, fix_rate_hz=10.0, lever_arm=ARM, **EXACT)
    # What is stamped at t was valid at t − latency.
    late = made.fixes.assign(t=np.round(made.fixes["t"] - 0.5, 6))
    both = late.merge(
        exact.fixes.assign(t=np.round(exact.fixes["t"], 6)), on="t", suffixes=("", "_")
    )
    true = both[["lat_", "lon_", "height_"]].set_axis(["lat", "lon", "height"], axis=1)
    assert len(both) > 1000
    error = apart(both, true)
    np.testing.assert_allclose(error.std(axis=0), [2.0, 2.0, 2.0 * 1.6], rtol=0.1)
    assert (both["v_e"] - both["v_e_"]).std() == pytest.approx(0.3, rel=0.1)
    speed = np.interp(made.odometer["t"] - 0.2, exact.odometer["t"], exact.odometer["speed"])
    moving = speed > 3.0
    assert np.std((made.odometer["speed"] - speed)[moving]) == pytest.approx(0.2, rel=0.15)
    assert (made.odometer["speed"][speed == 0.0] == 0.0).all()


def test_seeds(drive):
    one, same, other = (with_aiding_from_reference(drive, seed=s) for s in (1, 1, 2))
    pd.testing.assert_frame_equal(one.fixes, same.fixes)
    assert np.abs(apart(one.fixes, other.fixes)).max() > 1.0
    assert one.imu is drive.imu
    assert one.reference is drive.reference


def test_no_samples_where_the_reference_pauses(drive):
    gap = drive.reference["t"].between(30.0, 36.0, inclusive="neither")
    lame = replace(drive, reference=drive.reference[~gap].reset_index(drop=True))
    made = with_aiding_from_reference(lame, lever_arm=ARM, seed=1)
    whole = with_aiding_from_reference(drive, lever_arm=ARM, seed=1)
    for name in ("fixes", "odometer"):
        t = made.tables()[name]["t"]
        assert not t.between(30.01, 35.99).any()
        # The rest is drawn as if nothing were missing.
        kept = whole.tables()[name]
        kept = kept[kept["t"].isin(t)].reset_index(drop=True)
        away = (kept["t"] - 33.0).abs() > 3.2
        pd.testing.assert_frame_equal(made.tables()[name][away], kept[away])
    assert made.fixes.notna().all().all()


def test_metadata_say_it_and_survive_saving(drive, tmp_path):
    known = replace(drive.metadata, extra={"files": {"odometer": "odo.csv", "imu": "imu.csv"}})
    made = with_aiding_from_reference(replace(drive, metadata=known), odometer=None, seed=7)
    assert made.odometer.empty
    assert made.metadata.name.endswith("_semi_real_7")
    assert made.metadata.sensors["fixes"].startswith("semi-real: made from the reference, seed 7")
    assert made.metadata.sensors["odometer"] == "none"
    assert made.metadata.extra["semi_real"]["gnss"]["noise"] == 0.6
    back = load_log(save_log(made, tmp_path / "log"))
    pd.testing.assert_frame_equal(back.fixes, made.fixes)
    assert back.odometer.empty
    with pytest.raises(LogError, match=r"odometer has no rows"):
        riss_timeline(made, rate_hz=10.0)


def test_a_poor_reference(make_log, tables):
    reference = tables["reference"].drop(columns=["azimuth", "height"])
    made = with_aiding_from_reference(make_log(reference=reference), **EXACT)
    assert "height" not in made.fixes
    assert "v_u" not in made.fixes
    assert made.fixes["v_n"].tolist() == pytest.approx([9.5] * 11)
    np.testing.assert_allclose(made.odometer["speed"], np.hypot(0.3, 9.5), atol=1e-3)


@pytest.mark.parametrize(
    ("options", "dropped", "error", "message"),
    [
        ({}, "v_e", LogError, r"small: reference: no v_e, which aiding is made from \(found: t,"),
        ({"lever_arm": ARM}, "azimuth", LogError, "no azimuth, pitch, roll, .* with a lever arm"),
        ({"seed": -1}, "t", ConfigError, "seed: found -1"),
        ({"fix_rate_hz": 0.0}, "t", ConfigError, "fix_rate_hz: found 0.0"),
        ({"gnss": "memz"}, "t", ConfigError, "grade: found 'memz'"),
    ],
)
def test_refusals(make_log, tables, options, dropped, error, message):
    log = make_log(reference=tables["reference"].drop(columns=dropped))
    with pytest.raises(error, match=message):
        with_aiding_from_reference(log, **options)
    with pytest.raises(LogError, match=r"found: no reference"):
        with_aiding_from_reference(make_log(reference=None))


def test_kitti_with_aiding(data_folder):
    data_folder("kitti_oxts")
    log = read_log(DATASETS / "kitti_0018.yaml")
    made = with_aiding_from_reference(log, gnss=GnssGrade(noise=1.0), lever_arm=ARM, seed=11)
    # The drive pauses for 1.7 s at 156.6 s.
    assert not made.fixes["t"].between(156.7, 158.2).any()
    truth = reference_at(log, made.fixes["t"].to_numpy())
    error = apart(made.fixes, truth)
    assert np.sqrt(np.mean(error[:, :2] ** 2)) == pytest.approx(np.hypot(1.0, 0.63), rel=0.1)
    speed = np.interp(made.odometer["t"], made.fixes["t"], np.hypot(truth["v_e"], truth["v_n"]))
    assert np.corrcoef(speed, made.odometer["speed"])[0, 1] > 0.99
