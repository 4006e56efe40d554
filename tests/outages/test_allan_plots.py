import math
from pathlib import Path

import numpy as np
import pytest

from navlearn.logs.allan.deviation import allan_curve
from navlearn.logs.allan.standstill_noise import AxisNoise, StandstillNoise
from navlearn.logs.allan.stretch import Stretch
from navlearn.logs.allan.terms import noise_terms
from navlearn.outages.allan_plots import allan_table, curve_table, plot_allan


@pytest.fixture(scope="module")
def found() -> StandstillNoise:
    rng = np.random.default_rng(1)
    axes = []
    for name, sigma in (("gyro_z", math.radians(0.6) / 60.0), ("accel_x", 0.1 / 60.0)):
        curve = allan_curve(sigma * math.sqrt(50.0) * rng.normal(size=30_000), 50.0)
        axes.append(AxisNoise(axis=name, curve=curve, terms=noise_terms(curve), notes=()))
    return StandstillNoise(
        log="bench",
        stretch=Stretch(start=0.0, stop=600.0),
        rate_hz=50.0,
        axes=tuple(axes),
        left_out={},
    )


def test_coefficients_are_told_in_the_units_of_data_sheets(found: StandstillNoise) -> None:
    table = allan_table(found).set_index(["axis", "coefficient"])
    gyro, accel = table.loc[("gyro_z", "random walk")], table.loc[("accel_x", "random walk")]
    assert gyro["value"] == pytest.approx(0.6, rel=0.03)
    assert gyro["unit"] == "°/√h"
    assert accel["value"] == pytest.approx(0.1, rel=0.03)
    assert accel["unit"] == "m/s/√h"
    assert (table["low"] <= table["high"]).all()
    hidden = table[table["value"].isna()]
    assert len(hidden) >= 2
    assert (hidden["high"] > 0.0).all()


def test_units_of_instability_and_walk() -> None:
    rng = np.random.default_rng(2)
    walk = math.radians(30.0) / 3600.0 / 60.0  # 30 °/h/√h
    curve = allan_curve(walk / math.sqrt(10.0) * np.cumsum(rng.normal(size=72_000)), 10.0)
    one = AxisNoise(axis="gyro_x", curve=curve, terms=noise_terms(curve), notes=())
    noise = StandstillNoise(
        log="bench", stretch=Stretch(start=0.0, stop=7200.0), rate_hz=10.0, axes=(one,), left_out={}
    )
    row = allan_table(noise).set_index("coefficient").loc["bias random walk"]
    assert row["value"] == pytest.approx(30.0, rel=0.2)
    assert row["unit"] == "°/h/√h"


def test_curves_have_a_row_per_averaging_time(found: StandstillNoise) -> None:
    table = curve_table(found)
    assert len(table) == sum(one.curve.tau.size for one in found.axes)
    assert (table["low"] < table["deviation"]).all()
    assert (table["deviation"] < table["high"]).all()


def test_the_plot_is_drawn(found: StandstillNoise, tmp_path: Path) -> None:
    path = plot_allan(tmp_path / "allan.png", found)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 10_000
