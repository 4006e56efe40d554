import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from navlearn import frames
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.outages.acting import verdict_columns
from navlearn.outages.metrics import FIGURES

RADIUS = 6_371_000.0
LAT_0, LON_0 = 0.7, -1.3


def motion(speed: np.ndarray, azimuth: np.ndarray, dt: float) -> dict[str, np.ndarray]:
    """Positions on the ellipsoid whose velocity is exactly the given one, summed finely."""
    a, f = 6_378_137.0, 1.0 / 298.257223563
    e2 = f * (2.0 - f)
    v_e, v_n = speed * np.sin(azimuth), speed * np.cos(azimuth)
    lat, lon = np.empty_like(speed), np.empty_like(speed)
    lat[0], lon[0] = LAT_0, LON_0
    for k in range(1, speed.size):
        w = 1.0 - e2 * np.sin(lat[k - 1]) ** 2
        r_m, r_n = a * (1.0 - e2) / w**1.5, a / np.sqrt(w)
        lat[k] = lat[k - 1] + 0.5 * (v_n[k] + v_n[k - 1]) * dt / r_m
        middle = 0.5 * (lat[k] + lat[k - 1])
        lon[k] = lon[k - 1] + 0.5 * (v_e[k] + v_e[k - 1]) * dt / (r_n * np.cos(middle))
    return {"lat": lat, "lon": lon, "v_e": v_e, "v_n": v_n}


@pytest.fixture(scope="session")
def make_log() -> Callable[..., DriveLog]:
    """A drive of given speed and azimuth over time: sensors and reference 10 Hz, fixes 1 Hz."""

    def make(
        duration: float = 900.0,
        speed: Callable[[np.ndarray], np.ndarray] | float = 10.0,
        azimuth: Callable[[np.ndarray], np.ndarray] | float = 0.5,
        name: str = "made",
    ) -> DriveLog:
        t = np.arange(0.0, duration + 0.05, 0.1).round(6)
        v = np.broadcast_to(speed(t) if callable(speed) else speed, t.shape).astype(float)
        a = np.broadcast_to(azimuth(t) if callable(azimuth) else azimuth, t.shape).astype(float)
        moved = motion(v, a, 0.1)
        reference = pd.DataFrame(
            {"t": t, **moved, "height": 100.0, "azimuth": a, "v_u": 0.0, "pitch": 0.0, "roll": 0.0}
        )
        fixes = reference.loc[::10, ["t", "lat", "lon", "height", "v_e", "v_n"]]
        return DriveLog(
            imu=pd.DataFrame({"t": t, "gyro_z": -np.gradient(a, t)}),
            odometer=pd.DataFrame({"t": t, "speed": v}),
            fixes=fixes.reset_index(drop=True),
            reference=reference,
            metadata=LogMetadata(name=name, is_truth=True),
        )

    return make


@pytest.fixture(scope="session")
def straight_log(make_log: Callable[..., DriveLog]) -> DriveLog:
    return make_log()


@pytest.fixture(scope="session")
def make_rows() -> Callable[..., pd.DataFrame]:
    """Rows of outages: each method's error is nearly its factor times that of the first.

    A method of factor 1 has exactly its error; ``used`` tells who learns, and whether it acts.
    """

    def make(
        factors: Mapping[str, float],
        used: Mapping[str, bool],
        drives: tuple[str, ...] = ("made",),
        outages: int = 6,
        duration: float = 60.0,
        seed: int = 0,
        satellites: int = 0,
    ) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        rows = []
        for drive in drives:
            for outage in range(1, outages + 1):
                base = float(rng.gamma(6.0) * duration / 60.0)
                for method, factor in factors.items():
                    spread = float(rng.uniform(0.9, 1.1)) if factor != 1.0 else 1.0
                    notes: dict[str, object] = {}
                    if method in used:
                        notes = {"used": used[method], "reason": f"gate: {outage:+d} %"}
                    rows.append(
                        {
                            **dict.fromkeys(FIGURES, 1.0),
                            "drive": drive, "method": method, "outage": outage,
                            "start_s": 100.0 * outage, "duration_s": duration,
                            "satellites": satellites,
                            "satellites_visible": " ".join(f"G{k:02d}" for k in range(satellites)),
                            "dynamics": "turn", "failure": "", **verdict_columns(notes),
                            "max_horizontal_error_m": base * factor * spread,
                        }
                    )  # fmt: skip
        return pd.DataFrame(rows)

    return make


@pytest.fixture(scope="session")
def sky() -> Mapping[str, tuple[float, float]]:
    """Elevation and azimuth, degrees, of satellites that do not move against the Earth."""
    return {
        "G01": (80.0, 10.0),
        "G02": (60.0, 100.0),
        "G03": (45.0, 200.0),
        "G04": (30.0, 290.0),
        "E05": (20.0, 45.0),
        "R06": (12.0, 135.0),
        "G07": (5.0, 330.0),
    }


@pytest.fixture(scope="session")
def with_ranges(
    sky: Mapping[str, tuple[float, float]],
) -> Callable[..., DriveLog]:
    """A drive with ranges at 1 Hz to the satellites of the sky; ``lost`` tells which are not."""

    def make(
        log: DriveLog, lost: Callable[[str, np.ndarray], np.ndarray] | None = None
    ) -> DriveLog:
        assert log.reference is not None
        at = log.reference.iloc[::10]
        t = at["t"].to_numpy()
        place = [torch.tensor(at[name].to_numpy()) for name in ("lat", "lon", "height")]
        antenna = frames.ecef_from_geodetic(*place)
        turn = frames.enu_from_ecef_matrix(place[0], place[1])
        parts = []
        for name, (elevation, azimuth) in sky.items():
            e, a = math.radians(elevation), math.radians(azimuth)
            unit = [math.cos(e) * math.sin(a), math.cos(e) * math.cos(a), math.sin(e)]
            away = 2.2e7 * (turn.transpose(-1, -2) @ torch.tensor(unit, dtype=torch.float64))
            x, y, z = (antenna + away).T.numpy()
            part = pd.DataFrame({"t": t, "satellite": name, "pseudorange": 2.2e7})
            part = part.assign(range_rate=0.0, sat_x=x, sat_y=y, sat_z=z)
            parts.append(part if lost is None else part[~lost(name, t)])
        ranges = pd.concat(parts).sort_values(["t", "satellite"], ignore_index=True)
        return replace(log, ranges=ranges)

    return make
