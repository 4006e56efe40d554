"""Whatever is asked within bounds gives a usable log."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.logs.synthetic import GRADES, simulate_drive
from navlearn.logs.synthetic.profile import PROFILES
from navlearn.logs.validate import validate_log


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    profile=st.sampled_from(list(PROFILES)),
    grade=st.sampled_from(list(GRADES)),
    seed=st.integers(0, 2**32),
    duration=st.floats(20.0, 90.0),
    imu_rate_hz=st.floats(1.0, 120.0),
    fix_rate_hz=st.floats(0.5, 10.0),
    lat=st.floats(-1.5, 1.5),
)
def test_any_drive_passes_the_door(
    profile: str,
    grade: str,
    seed: int,
    duration: float,
    imu_rate_hz: float,
    fix_rate_hz: float,
    lat: float,
) -> None:
    drive = simulate_drive(
        profile=profile,
        grade=grade,
        seed=seed,
        duration=duration,
        imu_rate_hz=imu_rate_hz,
        fix_rate_hz=fix_rate_hz,
        origin=(lat, 3.1, 100.0),
        standstill=5.0,
    )
    for log in (drive.log, drive.ideal):
        validate_log(log)
        for table in log.tables().values():
            assert np.isfinite(table.to_numpy()).all()
            assert table["t"].iloc[-1] <= duration + 1e-9
    assert len(drive.log.imu) == math.floor(duration * imu_rate_hz + 1e-9)
