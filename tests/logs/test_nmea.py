import gzip
import math
import sys
from datetime import UTC, datetime

import numpy as np
import pytest
import yaml

from navlearn.errors import ConfigError, LogError, MissingExtraError
from navlearn.logs.formats.nmea import read_nmea
from navlearn.logs.reading import read_log

pytest.importorskip("pynmeagps", reason="navlearn[gnss] is not installed")

KNOT = 1852.0 / 3600.0
START = datetime(2026, 3, 1, 23, 59, 56, tzinfo=UTC).timestamp()


def line(body):
    """Return a sentence with its checksum: the exclusive or of what stands between $ and *."""
    total = 0
    for letter in body:
        total ^= ord(letter)
    return f"${body}*{total:02X}"


def clock(k):
    """Return time and date of the k-th second; midnight passes after the fourth."""
    return datetime.fromtimestamp(START + k, UTC).strftime("%H%M%S.00 %d%m%y").split()


def gga(k, *, quality=1, lat="4906.6000,N", alt="115.2", sep="48.1"):
    return line(f"GNGGA,{clock(k)[0]},{lat},00824.3000,W,{quality},09,1.0,{alt},M,{sep},M,,")


def rmc(k, *, status="A", speed="19.4384", course="090.0", mode="A", dated=True):
    day = clock(k)[1] if dated else ""
    return line(
        f"GNRMC,{clock(k)[0]},{status},4906.6000,N,00824.3000,W,{speed},{course},{day},,,{mode}"
    )


def gst(k):
    return line(f"GNGST,{clock(k)[0]},1.0,1.5,0.8,30.0,1.2,0.9,2.1")


def vtg(speed):
    return line(f"GNVTG,180.0,T,,M,{speed / KNOT:.6f},N,,K,A")


@pytest.fixture
def text(tmp_path):
    def write(*lines, name="track.nmea"):
        path = tmp_path / name
        content = "\r\n".join(lines).encode("latin-1")
        path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
        return path

    return write


def test_one_fix_per_epoch_over_midnight(text):
    lines = [part for k in range(10) for part in (rmc(k), gga(k), gst(k), vtg(3.0))]
    for name in ("track.nmea", "track.nmea.gz"):
        found = read_nmea(text(*lines, name=name))
        assert found.dated
        fixes = found.fixes
        np.testing.assert_array_equal(fixes["t"], START + np.arange(10.0))
        row = fixes.iloc[0]
        assert row["lat"] == pytest.approx(math.radians(49.11), abs=1e-12)
        assert row["lon"] == pytest.approx(-math.radians(8.405), abs=1e-12)
        # Height over the sea and the receiver's geoid separation.
        assert row["height"] == pytest.approx(163.3)
        # RMC's velocity is preferred to VTG's: 19.4384 knots are 10 m/s, to the east.
        assert (row["v_e"], row["v_n"]) == pytest.approx((10.0, 0.0), abs=1e-4)
        assert (row["std_e"], row["std_n"], row["std_u"], row["satellites"]) == (0.9, 1.2, 2.1, 9.0)
        assert found.notes == {"format": "nmea", "time": "UTC"}


def test_a_southern_position_without_separation_and_without_gst(text):
    lines = [part for k in range(3) for part in (rmc(k), gga(k, lat="3306.6000,S", sep=""))]
    fixes = read_nmea(text(*lines)).fixes
    assert fixes["lat"].iloc[0] == pytest.approx(-math.radians(33.11))
    assert fixes["height"].tolist() == [115.2] * 3
    assert "std_e" not in fixes


def test_wrong_checksums_and_damaged_lines_are_counted(text):
    wrong = gga(1).replace("115.2", "915.2")
    lines = [rmc(0), gga(0), wrong, rmc(1), "$GNGGA,half", "\xff\xfe", rmc(2), gga(2), "GNGGA,no"]
    found = read_nmea(text(*lines))
    # The epoch whose GGA is damaged has the position of RMC, and no height.
    assert found.fixes["height"].isna().tolist() == [False, True, False]
    assert found.fixes["lat"].notna().all()
    assert found.notes["checksum errors"] == 1
    assert found.notes["damaged sentences"] == 1


def test_epochs_without_a_fix(text):
    lines = [
        *(rmc(0), gga(0)),
        *(rmc(1, status="V"), gga(1, quality=0)),
        *(rmc(2, mode="E"), gga(2, quality=6)),  # dead reckoning of the receiver
        rmc(3, status="V"),
        *(rmc(4, mode="N"), gga(4, quality=4)),  # a position, and no velocity
    ]
    found = read_nmea(text(*lines))
    assert (found.fixes["t"] - START).tolist() == [0.0, 4.0]
    assert found.fixes["v_e"].isna().tolist() == [False, True]
    assert found.notes["epochs without a fix"] == 3


def test_standing_and_crawling(text):
    lines = [part for k, speed in enumerate(("0.0", "0.2")) for part in (
        gga(k), rmc(k, speed=speed, course=""))]  # fmt: skip
    fixes = read_nmea(text(*lines)).fixes
    assert (fixes["v_e"].iloc[0], fixes["v_n"].iloc[0]) == (0.0, 0.0)
    assert np.isnan(fixes["v_e"].iloc[1])


@pytest.mark.parametrize("first", [True, False])
def test_vtg_before_or_after_its_epoch(text, first):
    lines = []
    for k in range(6):
        lines += [vtg(k + 1.0), gga(k)] if first else [gga(k), vtg(k + 1.0)]
    found = read_nmea(text(*lines))
    assert not found.dated
    np.testing.assert_allclose(found.fixes["v_n"], -np.arange(1.0, 7.0), rtol=1e-6)


def test_a_date_that_comes_late_reaches_back_over_midnight(text):
    lines = [gga(k) for k in range(6)] + [line("GNZDA,000002.00,02,03,2026,00,00")]
    np.testing.assert_array_equal(read_nmea(text(*lines)).fixes["t"], START + np.arange(6.0))


def test_nothing_to_read(text, monkeypatch):
    with pytest.raises(LogError, match=r"track.nmea: no GGA or RMC sentence with a fix \(no sent"):
        read_nmea(text("hello", "world"))
    with pytest.raises(LogError, match=r"with a fix \(1 epochs without a fix\)"):
        read_nmea(text(rmc(0, status="V")))
    path = text(rmc(0), name="track.nmea.gz")
    path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(LogError, match=r"track.nmea.gz: not readable as gzip"):
        read_nmea(path)
    monkeypatch.setitem(sys.modules, "pynmeagps", None)
    with pytest.raises(MissingExtraError, match=r"pip install navlearn\[gnss\]"):
        read_nmea(text(rmc(0)))


@pytest.fixture
def drive(tmp_path, tables, text):
    """Write a drive of a plain IMU table and an NMEA track."""

    def write(lines=None, t=0.0, fixes=None, **entries):
        track = lines or [part for k in range(11) for part in (rmc(k), gga(k))]
        text(*track)
        imu = tables["imu"]
        imu.assign(t=imu["t"] + t).to_csv(tmp_path / "imu.csv", index=False)
        layout = {"imu": {"file": "imu.csv"}, "fixes": {"file": "track.nmea", **(fixes or {})}}
        path = tmp_path / "drive.yaml"
        start = {"name": "drive", "format": "csv", "path": ".", "tables": layout}
        path.write_text(yaml.safe_dump({**start, **entries}), encoding="utf-8")
        return path

    return write


def test_a_drive_of_imu_and_nmea(drive):
    for log in (
        read_log(drive(t=START - 2.0)),
        read_log(drive(t=30.0, fixes={"clock_start": "2026-03-01T23:59:24Z"})),
        read_log(drive(t=30.0, fixes={"clock_start": "2026-03-02T00:59:24+01:00"})),
    ):
        # The IMU begins two seconds before the first fix.
        np.testing.assert_allclose(log.imu["t"].iloc[0], 0.0, atol=1e-6)
        np.testing.assert_allclose(log.fixes["t"], 2.0 + np.arange(11.0), atol=1e-6)
        assert log.odometer.empty
        assert log.metadata.extra["receiver"] == {"fixes": {"format": "nmea", "time": "UTC"}}


def test_a_track_without_a_date(drive):
    lines = [gga(k) for k in range(11)]
    log = read_log(drive(lines, fixes={"clock_start": "2026-03-01T23:59:54Z"}))
    np.testing.assert_allclose(log.fixes["t"], 2.0 + np.arange(11.0))
    with pytest.raises(LogError, match=r"track.nmea: no sentence tells the date .*clock_start"):
        read_log(drive(lines))


def test_a_stated_geoid_replaces_the_receivers(drive):
    log = read_log(drive(t=START, geoid_height=50.0))
    np.testing.assert_allclose(log.fixes["height"], 165.2)


def test_clocks_apart(drive):
    message = (
        r"track.nmea: fixes from 2026-03-01 23:59:56 UTC to 2026-03-02 00:00:06 UTC, IMU from "
        r"0.00 s to 10.00 s: no time in common; state clock_start"
    )
    with pytest.raises(LogError, match=message):
        read_log(drive())


def test_a_text_of_another_ending_and_another_table(drive, tmp_path):
    path = drive(t=START, fixes={"file": "track.txt", "format": "nmea"})
    (tmp_path / "track.nmea").rename(tmp_path / "track.txt")
    assert len(read_log(path).fixes) == 11
    entries = yaml.safe_load(path.read_text())
    entries["tables"]["reference"] = {"file": "track.txt", "format": "nmea"}
    path.write_text(yaml.safe_dump(entries))
    with pytest.raises(ConfigError, match=r"tables.reference: a receiver's file \(nmea\) gives"):
        read_log(path)
    entries["tables"]["fixes"]["clock_start"] = "2026-03-01T23:59:28"
    path.write_text(yaml.safe_dump(entries))
    with pytest.raises(ConfigError, match=r"clock_start: Input should have timezone info"):
        read_log(path)


def test_a_folder_without_a_descriptor(drive, tmp_path):
    drive(t=START)
    (tmp_path / "track.nmea").rename(tmp_path / "gnss.nmea")
    (tmp_path / "drive.yaml").unlink()
    assert len(read_log(tmp_path).fixes) == 11
