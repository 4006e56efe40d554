import math

import numpy as np
import pandas as pd
import pytest
import yaml

from navlearn import wgs84
from navlearn.errors import LogError
from navlearn.logs.local_positions import from_mercator, from_tangent_plane
from navlearn.logs.reading import read_log
from navlearn.logs.table_layout import Origin

ORIGIN = Origin(lat_deg=49.0, lon_deg=8.4, height=115.0)


def mercator(lat_deg, lon_deg, lat_0_deg, lon_0_deg):
    """Map as KITTI's development kit does: metres from an origin."""
    scale = math.cos(math.radians(lat_0_deg)) * wgs84.SEMI_MAJOR_AXIS

    def up_to(lat):
        return math.log(math.tan(math.pi * (90.0 + lat) / 360.0))

    return (
        scale * math.radians(lon_deg - lon_0_deg),
        scale * (up_to(lat_deg) - up_to(lat_0_deg)),
    )


def test_undoing_kittis_map():
    east, north = mercator(49.031, 8.355, 49.0, 8.4)
    lat, lon, height = from_mercator(
        np.array([east, 0.0]), np.array([north, 0.0]), np.array([3.0, 0.0]), ORIGIN
    )
    np.testing.assert_allclose(np.degrees(lat), [49.031, 49.0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(lon), [8.355, 8.4], atol=1e-12)
    np.testing.assert_allclose(height, [118.0, 115.0])


def test_a_tangent_plane_at_the_pole_and_at_the_equator():
    # 100 km along the plane at the equator: atan(d / a) to the east, and high above the Earth.
    a, way = wgs84.SEMI_MAJOR_AXIS, np.array([100e3])
    zero = np.zeros(1)
    origin = Origin(lat_deg=0.0, lon_deg=10.0)
    lat, lon, height = from_tangent_plane(way, zero, zero, origin)
    assert lat == pytest.approx(0.0, abs=1e-15)
    assert lon[0] == pytest.approx(math.radians(10.0) + math.atan(1e5 / a), abs=1e-14)
    assert height[0] == pytest.approx(math.hypot(a, 1e5) - a, abs=1e-6)
    # North from the equator by a small way: the meridian's radius there is a (1 − e²).
    lat, _, height = from_tangent_plane(zero, np.array([100.0]), np.array([5.0]), origin)
    radius = a * (1.0 - wgs84.ECCENTRICITY_SQUARED)
    assert lat[0] == pytest.approx(100.0 / (radius + 5.0), rel=1e-8)
    assert height[0] == pytest.approx(5.0, abs=1e-3)


@pytest.fixture
def local_log(tmp_path, tables):
    """Write a drive whose reference is in local metres."""

    def write(reference, **entries):
        folder = tmp_path / "log"
        folder.mkdir(exist_ok=True)
        tables["imu"].to_csv(folder / "imu.csv", index=False)
        reference.to_csv(folder / "reference.csv", index=False)
        columns = {"east": "e", "north": "n", "up": "u"} if "u" in reference else {"east": "e"}
        layout = {
            "imu": {"file": "imu.csv"},
            "reference": {"file": "reference.csv", "columns": columns},
        }
        path = tmp_path / "local.yaml"
        start = {"name": "local", "format": "csv", "path": "log", "tables": layout}
        path.write_text(yaml.safe_dump({**start, **entries}), encoding="utf-8")
        return path

    return write


LOCAL = pd.DataFrame({"t": np.arange(11.0), "e": 0.0, "n": 10.0 * np.arange(11.0), "u": 2.0})


def test_local_metres_at_the_door(local_log):
    log = read_log(local_log(LOCAL, origin={"lat_deg": 49.0, "lon_deg": 8.4, "height": 115.0}))
    assert log.fixes.empty
    north = np.radians(49.0) + 10.0 * np.arange(11.0) / (6_371_800.0 + 117.0)
    np.testing.assert_allclose(log.reference["lat"], north, atol=2e-9)
    np.testing.assert_allclose(log.reference["height"], 117.0, atol=1e-3)
    assert "east" not in log.reference


def test_local_metres_without_an_origin(local_log):
    with pytest.raises(LogError, match=r"reference.csv: local positions \(east, north, up\) need"):
        read_log(local_log(LOCAL))
    with pytest.raises(LogError, match=r"\(east\) need east and north"):
        read_log(local_log(LOCAL.drop(columns="u"), origin={"lat_deg": 49.0, "lon_deg": 8.4}))


def test_a_section_of_a_drive(local_log):
    origin = {"lat_deg": 49.0, "lon_deg": 8.4}
    log = read_log(local_log(LOCAL, origin=origin, section_s=[3.0, 7.5]))
    assert log.imu["t"].iloc[[0, -1]].tolist() == pytest.approx([0.0, 4.4])
    assert log.reference["t"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert log.metadata.time_origin == 3.0
    with pytest.raises(LogError, match=r"section_s: no IMU sample from 20.00 to inf s of 0.00 to"):
        read_log(local_log(LOCAL, origin=origin, section_s=[20.0, None]))


def test_a_reference_with_two_clocks(local_log):
    reference = LOCAL.assign(v_e=0.5 * LOCAL["t"], v_n=10.0)
    path = local_log(
        reference,
        origin={"lat_deg": 49.0, "lon_deg": 8.4},
        reference_latency={"pose": -0.25, "velocity": 0.5},
    )
    entries = yaml.safe_load(path.read_text())
    entries["tables"]["reference"]["columns"] |= {"v_e": "v_e", "v_n": "v_n"}
    path.write_text(yaml.safe_dump(entries))
    log = read_log(path)
    plain = read_log(local_log(LOCAL, origin={"lat_deg": 49.0, "lon_deg": 8.4}))
    # What was stamped at 3 s holds at 3.25 s; no position is interpolated.
    np.testing.assert_array_equal(log.reference["t"], plain.reference["t"] + 0.25)
    np.testing.assert_array_equal(log.reference["lat"], plain.reference["lat"])
    # The velocity 0.5 t stamped at t holds at t − 0.5, and so at 3.25 s is that stamped at 3.75 s.
    np.testing.assert_allclose(log.reference["v_e"][:10], 0.5 * (np.arange(10.0) + 0.75))
    assert np.isnan(log.reference["v_e"].iloc[-1])
    removed = log.metadata.extra["reference_latency_removed"]
    assert removed == {"pose": -0.25, "velocity": 0.5}
