"""Faults in the fixes of swept drives: drawn anew per seed, the drive itself unchanged."""

import numpy as np
import pandas as pd
import pytest

from navlearn.errors import ConfigError
from navlearn.experiment.sweep_drives import make_drive
from navlearn.logs.synthetic import simulate_drive
from navlearn.recipe.strict import parse
from navlearn.recipe.sweep import SweepRecipe

CONTENT = {
    "name": "many",
    "sweep": {
        "type": "simulated",
        "grades": ["mems_m"],
        "drives": 2,
        "first_seed": 11,
        "profile": "town",
        "duration_s": 300,
        "faults": {"spikes": {"sizes_m": [40], "per_hour": 120}, "settle_s": 5, "apart_s": 5},
    },
}


def test_fixes_of_every_drive_are_hit_at_other_times() -> None:
    sweep = parse(SweepRecipe, CONTENT, file="here")
    hits = []
    for seed in (11, 12):
        log, truth = make_drive(sweep, "mems_m", seed)
        plain = simulate_drive(
            profile="town", grade="mems_m", duration=300.0, seed=seed, imu_rate_hz=10.0
        ).log
        pd.testing.assert_frame_equal(log.imu, plain.imu)
        north = 6.367e6 * (log.fixes["lat"] - plain.fixes["lat"])
        east = 6.4e6 * np.cos(plain.fixes["lat"]) * (log.fixes["lon"] - plain.fixes["lon"])
        off = np.hypot(east, north).to_numpy()
        hits.append(tuple(np.flatnonzero(off > 1.0)))
        assert truth is not None
        np.testing.assert_allclose(off[off > 1.0], 40.0, rtol=0.02)
        again, _ = make_drive(sweep, "mems_m", seed)
        pd.testing.assert_frame_equal(again.fixes, log.fixes)
    assert hits[0] != hits[1]
    assert min(map(len, hits)) > 2


def test_unknown_faults_are_refused() -> None:
    wrong = {**CONTENT["sweep"], "faults": {"spike": {}}}  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match="did you mean 'spikes'"):
        parse(SweepRecipe, {**CONTENT, "sweep": wrong}, file="here")
