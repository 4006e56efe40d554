"""Whatever is received within bounds gives a usable log, and nothing received is said."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.errors import LogError
from navlearn.logs.synthetic import PRESETS, simulate_drive
from navlearn.logs.validate import validate_log

SYSTEMS = [("G",), ("E",), ("R", "G"), ("G", "E", "R")]


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    preset=st.sampled_from(list(PRESETS)),
    systems=st.sampled_from(SYSTEMS),
    seed=st.integers(0, 2**32),
    fix_rate_hz=st.sampled_from([0.5, 1.0, 5.0]),
    lat=st.floats(-1.5, 1.5),
    gps_time=st.one_of(st.none(), st.floats(0.0, 2e9)),
    figures=st.fixed_dictionaries(
        {
            "canyon_share": st.floats(0.0, 0.5),
            "reflections_per_hour": st.floats(0.0, 300.0),
            "multipath_time": st.floats(1.0, 1e3),
            "clock_rate": st.floats(-1e3, 1e3),
            "clock_jump": st.sampled_from([0.0, 1e-3]),
            "systematic": st.floats(0.0, 3.0),
        }
    ),
)
def test_any_sky_passes_the_door(
    preset: str,
    systems: tuple[str, ...],
    seed: int,
    fix_rate_hz: float,
    lat: float,
    gps_time: float | None,
    figures: dict[str, float],
) -> None:
    drive = simulate_drive(
        profile="town",
        seed=seed,
        duration=60.0,
        imu_rate_hz=5.0,
        fix_rate_hz=fix_rate_hz,
        origin=(lat, 3.1, 100.0),
        standstill=5.0,
        satellites=replace(PRESETS[preset], systems=systems, gps_time=gps_time, **figures),
    )
    for log in (drive.log, drive.ideal):
        validate_log(log)
        assert log.ranges is not None
        assert np.isfinite(log.ranges.drop(columns="satellite").to_numpy()).all()
        assert set(log.ranges["satellite"].str[0]) <= set(systems)
        assert log.ranges["pseudorange"].between(1e7, 5e7).all()
    assert drive.range_truth is not None
    truth = drive.range_truth.of(drive.log).table.drop(columns="satellite")
    assert np.isfinite(truth.to_numpy()).all()


def test_a_closed_sky_is_told() -> None:
    closed = replace(PRESETS["open_sky"], lowest_deg=89.0)
    asked = {"profile": "town", "duration": 40.0, "imu_rate_hz": 5.0, "seed": 11}
    with pytest.raises(LogError, match="or set fixes: drawn"):
        simulate_drive(satellites=closed, **asked)  # type: ignore[arg-type]
    drawn = simulate_drive(satellites=replace(closed, fixes="drawn"), **asked)  # type: ignore[arg-type]
    assert drawn.log.ranges is not None
    assert drawn.log.ranges.empty
    assert len(drawn.log.fixes) == 41
