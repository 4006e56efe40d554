"""A drive whose ranges err as told, what learns from it, and outages in it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from navlearn.experiment.tight_filter_runs import TightFilterRuns
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.synthetic import simulate_drive
from navlearn.logs.synthetic.satellite_options import PRESETS
from navlearn.outages.schedule import Outage
from navlearn.recipe import Recipe
from navlearn.recipe.range_error_spec import RangeErrorSpec

START = 520.0
DURATION = 30.0
QUICK: dict[str, Any] = {
    "window_s": 400.0,
    "gate_horizon_s": 30.0,
    "gate_every_s": 30.0,
    "gate_replays": 8,
}


def _driven(**sky: Any) -> DriveLog:
    """A drive whose ranges err as told and in nothing else."""
    return simulate_drive(
        profile="town",
        grade="tactical",
        duration=START + DURATION + 20.0,
        seed=7,
        imu_rate_hz=10.0,
        name="short",
        satellites=replace(PRESETS["ideal"], **sky),
    ).log


def _spec(structure: str = "pci", **content: Any) -> RangeErrorSpec:
    told = {"name": "model", "structure": structure, **QUICK, **content}
    return RangeErrorSpec.model_validate(told)


def _fresh_runs() -> TightFilterRuns:
    simulated = {"profile": "town", "grade": "tactical", "duration_s": 600.0, "seed": 7}
    return TightFilterRuns(
        Recipe.model_validate({"name": "a", "log": {"simulated": simulated}, "methods": ["tc_ekf"]})
    )


def _highest(log: DriveLog, count: int) -> Outage:
    """An outage through which the satellites of the strongest signal stay."""
    assert log.ranges is not None
    through = log.ranges[log.ranges["t"].between(START - 250.0, START + DURATION)]
    found = through.groupby("satellite")["cn0"].agg(["size", "mean"])
    always = found[found["size"] == found["size"].max()].sort_values("mean", ascending=False)
    return Outage(START, DURATION, tuple(str(name) for name in always.index[:count]))


@pytest.fixture(scope="session")
def systematic() -> DriveLog:
    return _driven(thermal=0.3, systematic=6.0, fading=2.0)


@pytest.fixture(scope="session")
def runs() -> TightFilterRuns:
    return _fresh_runs()


@pytest.fixture(scope="session")
def driven() -> Callable[..., DriveLog]:
    """What drives with ranges that err as told and in nothing else."""
    return _driven


@pytest.fixture(scope="session")
def spec() -> Callable[..., RangeErrorSpec]:
    """What makes a recipe's model of range errors, quick to fit."""
    return _spec


@pytest.fixture(scope="session")
def fresh_runs() -> Callable[[], TightFilterRuns]:
    """What makes filter runs that know of no other."""
    return _fresh_runs


@pytest.fixture(scope="session")
def highest() -> Callable[[DriveLog, int], Outage]:
    """What finds an outage through which the satellites of the strongest signal stay."""
    return _highest
