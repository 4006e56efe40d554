"""A minute of RINEX solved by RTKLIB from the files, and by us: the same place."""

import gzip
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from navlearn.frames import ecef_from_geodetic, enu_from_ecef_matrix, geodetic_from_ecef
from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.gnss.single_point_options import SinglePointOptions
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.range_layout import RangeOptions
from navlearn.logs.reading import read_log
from navlearn.logs.single_point_fixes import SinglePointFixOptions, solve_receptions

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("NAVLEARN_DATA") or ROOT / ".." / "shared" / "data")
RAW = DATA / "rinex_static" / "raw"
OBSERVATIONS = RAW / "reach-m2-01_raw_202306291111.23O.gz"
NAVIGATION = RAW / "reach-m2-01_raw_202306291111.nav"
SYSTEMS = {"G": 1, "E": 8, "GREC": 1 | 4 | 8 | 32}
EVERY = 60

rtklib = pytest.importorskip("pyrtklib")
pytest.importorskip("georinex")
pytestmark = pytest.mark.skipif(not OBSERVATIONS.is_file(), reason="rinex_static is not there")


@pytest.fixture(scope="module")
def log() -> DriveLog:
    with pytest.warns(UserWarning, match="no orbit"):
        return read_log(ROOT / "datasets" / "rinex_static.yaml")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    """Observations and navigation as RTKLIB reads them."""
    plain = tmp_path_factory.mktemp("rinex") / "minute.23O"
    plain.write_bytes(gzip.decompress(OBSERVATIONS.read_bytes()))
    observed, told, station = rtklib.obs_t(), rtklib.nav_t(), rtklib.sta_t()
    for path in (plain, NAVIGATION):
        rtklib.readrnx(str(path), 1, "", observed, told, station)
    rtklib.sortobs(observed)
    rtklib.uniqnav(told)
    return observed, told


def receptions(observed: Any) -> Iterator[Any]:
    """Yield the observations of every so many receptions."""
    first, count = 0, 0
    while first < observed.n:
        last = first
        while (
            last < observed.n
            and abs(rtklib.timediff(observed.data[last].time, observed.data[first].time)) < 1e-3
        ):
            last += 1
        if count % EVERY == 0:
            part = rtklib.Arr1Dobsd_t(last - first)
            for k in range(last - first):
                part[k] = observed.data[first + k]
            yield part, last - first
        first, count = last, count + 1


def by_rtklib(observed: Any, told: Any, systems: int) -> np.ndarray:
    """Return Earth-fixed positions, m: over 10°, Klobuchar, Saastamoinen."""
    options = rtklib.prcopt_t()
    options.mode, options.nf, options.navsys, options.elmin = 0, 1, systems, math.radians(10.0)
    options.ionoopt, options.tropopt, options.maxgdop = 1, 1, 30.0
    for k, value in enumerate((100.0, 0.003, 0.003)):
        options.err[k] = value
    found = []
    for part, count in receptions(observed):
        solution, seen = rtklib.sol_t(), rtklib.Arr1Dssat_t(255)
        angles, message = rtklib.Arr1Ddouble(2 * count), rtklib.Arr1Dchar(128)
        solved = rtklib.pntpos(part.ptr, count, told, options, solution, angles, seen.ptr, message)
        assert solved == 1
        found.append([solution.rr[k] for k in range(3)])
    return np.array(found)


@pytest.mark.parametrize(("letters", "within"), [("G", 0.8), ("E", 0.3), ("GREC", 1.0)])
def test_same_place(log: DriveLog, files: tuple[Any, Any], letters: str, within: float) -> None:
    """Weights differ in their figures, so that single ranges of metres do not count alike."""
    theirs = torch.tensor(by_rtklib(*files, SYSTEMS[letters]))
    noise = RangeNoiseOptions(multipath=0.3, thermal=0.3, ionosphere=1.0)
    single = SinglePointOptions(noise=noise, probability=1.0, huber=math.inf)
    options = SinglePointFixOptions(ranges=RangeOptions(systems=letters), single_point=single)
    points = solve_receptions(log, options).points
    assert points.ok.all()
    ours = ecef_from_geodetic(points.lat, points.lon, points.height)[::EVERY]
    lat, lon, _ = geodetic_from_ecef(theirs.mean(0))
    apart = (ours - theirs) @ enu_from_ecef_matrix(lat, lon).T
    assert len(apart) == 11
    assert (apart.mean(0)[:2].abs() < within).all(), apart.mean(0)
    assert abs(float(apart.mean(0)[2])) < 2.0 * within, apart.mean(0)
