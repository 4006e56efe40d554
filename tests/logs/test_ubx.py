import math
import struct
import sys
from datetime import UTC, datetime

import numpy as np
import pytest

from navlearn.errors import LogError, MissingExtraError
from navlearn.logs.formats.ubx import read_ubx
from navlearn.logs.reading import read_log

pytest.importorskip("pyubx2", reason="navlearn[gnss] is not installed")

LEAP = 18
WEEK = 604800
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC).timestamp()
# Five seconds before a GPS week ends: Saturday, 28 February 2026.
START = GPS_EPOCH + 2408 * WEEK - 5 - LEAP


def frame(kind, payload):
    """Return a u-blox message: its checksum is Fletcher's over class to payload."""
    body = kind + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) % 256
        b = (b + a) % 256
    return b"\xb5\x62" + body + bytes((a, b))


def pvt(k, *, fix=3, ok=1, valid=7, nano=-120_000):
    """Return the NAV-PVT of the k-th second, laid out by the interface description."""
    utc = datetime.fromtimestamp(START + k - (nano < 0), UTC)
    tow = round((START + k + LEAP - GPS_EPOCH) % WEEK * 1e3)
    payload = struct.pack(
        "<IHBBBBBBIiBBBBiiiiIIiiiiiIIHHIih H".replace(" ", ""),
        tow, utc.year, utc.month, utc.day, utc.hour, utc.minute, utc.second, valid, 25,
        nano + (10**9 if nano < 0 else 0), fix, ok, 0, 11,
        -84050000, 491100000, 163300, 115200, 1500, 2500,
        10_000, -4_000, 500, 10_770, 0, 120, 0, 99, 0, 0, 0, 0, 0,
    )  # fmt: skip
    assert len(payload) == 92
    return frame(b"\x01\x07", payload)


@pytest.fixture
def track(tmp_path):
    def write(*messages, name="track.ubx"):
        path = tmp_path / name
        path.write_bytes(b"".join(messages))
        return path

    return write


def test_fields_units_and_a_new_gps_week(track):
    noise = (frame(b"\x01\x35", bytes(20)), b"$GNRMC,1*00\r\n", b"junk")
    found = read_ubx(track(*noise, *(pvt(k) for k in range(10)), noise[0]))
    np.testing.assert_array_equal(found.fixes["t"], START + np.arange(10.0))
    row = found.fixes.iloc[3]
    assert row["lat"] == pytest.approx(math.radians(49.11), abs=1e-12)
    assert row["lon"] == pytest.approx(-math.radians(8.405), abs=1e-12)
    # North, east, down in mm/s become east, north, up.
    assert row[["v_e", "v_n", "v_u"]].tolist() == [-4.0, 10.0, -0.5]
    assert row[["height", "std_e", "std_n", "std_u", "std_v", "satellites"]].tolist() == [
        163.3, 1.5, 1.5, 2.5, 0.12, 11.0,
    ]  # fmt: skip
    assert found.notes["leap_seconds_known"] is True


def test_epochs_before_utc_is_resolved(track):
    # Leap seconds unknown: UTC is false by two seconds, the time of week is not.
    early = [pvt(k, valid=3) for k in range(3)]
    wrong = [frame(b"\x01\x07", m[6:16] + bytes(((m[16] + 2) % 60,)) + m[17:-2]) for m in early]
    assert wrong[0] != early[0]
    found = read_ubx(track(*wrong, *(pvt(k) for k in range(3, 8))))
    np.testing.assert_array_equal(found.fixes["t"], START + np.arange(8.0))
    assert read_ubx(track(*early)).notes["leap_seconds_known"] is False
    with pytest.raises(LogError, match=r"none of 3 NAV-PVT messages has a valid UTC date"):
        read_ubx(track(*(pvt(k, valid=0) for k in range(3))))


def test_what_is_no_fix(track):
    kinds = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5}
    found = read_ubx(track(*(pvt(k, fix=kind) for k, kind in kinds.items()), pvt(6, ok=0)))
    assert (found.fixes["t"] - START).tolist() == [2.0, 3.0, 4.0]
    # A two-dimensional fix has no height of its own.
    assert found.fixes["height"].isna().tolist() == [True, False, False]
    assert found.notes["epochs without a fix"] == 4


def test_damaged_messages_are_counted(track):
    bad = bytearray(pvt(1))
    bad[40] ^= 1
    found = read_ubx(track(pvt(0), bytes(bad), pvt(2), pvt(3)[:50]))
    assert (found.fixes["t"] - START).tolist() == [0.0, 2.0]
    assert found.notes["checksum errors"] == 1


def test_nothing_to_read(track, monkeypatch):
    with pytest.raises(LogError, match=r"track.ubx: no NAV-PVT message with a fix \(found 0 of"):
        read_ubx(track(b"this is a text"))
    with pytest.raises(LogError, match=r"with a fix \(found 1 of them\)"):
        read_ubx(track(pvt(0, fix=0)))
    monkeypatch.setitem(sys.modules, "pyubx2", None)
    with pytest.raises(MissingExtraError, match=r"pip install navlearn\[gnss\]"):
        read_ubx(track(pvt(0)))


def test_a_folder_with_an_imu_beside(track, tmp_path, tables):
    track(*(pvt(k) for k in range(10)), name="fixes.ubx")
    imu = tables["imu"]
    imu.assign(t=imu["t"] + START + 0.5).to_csv(tmp_path / "imu.csv", index=False)
    log = read_log(tmp_path)
    np.testing.assert_allclose(log.fixes["t"], np.arange(10.0), atol=1e-6)
    np.testing.assert_allclose(log.imu["t"].iloc[0], 0.5, atol=1e-6)
    assert log.metadata.extra["receiver"]["fixes"]["format"] == "ubx"
