"""Raw data gone bad: what spoils ranges, and a drive under the filter that takes them."""

from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import pytest
from torch import Tensor

from navlearn.fusion.tight.history import TightHistory
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.states import SatelliteRanges


@pytest.fixture(scope="session")
def scene(range_drive: Callable[..., Any], off: Callable[..., Tensor]) -> Callable[..., Any]:
    d = range_drive(seconds=60, seed=1)
    ekf = TightEkf(RissVehicle(d.options), systems=2)

    def run(ranges: SatelliteRanges | None = None, **other: Any) -> tuple[TightHistory, Tensor]:
        given = d._replace(**other)
        history = ekf(given.start, given.samples, ranges or d.ranges, given.timing)
        return history, off(history, d.truth)

    @lru_cache
    def plain() -> tuple[TightHistory, Tensor]:
        return run()

    run.drive, run.plain = d, plain  # type: ignore[attr-defined]
    return run


def changed(ranges: SatelliteRanges, **channels: Callable[[Tensor], None]) -> SatelliteRanges:
    """Ranges some of whose channels are changed in place of a copy."""
    new = {}
    for name, change in channels.items():
        new[name] = getattr(ranges, name).clone()
        change(new[name])
    return ranges._replace(**new)


def add(value: float | Tensor, *where: Any) -> Callable[[Tensor], None]:
    def change(x: Tensor) -> None:
        x[where] += value

    return change


def put(value: float, *where: Any) -> Callable[[Tensor], None]:
    def change(x: Tensor) -> None:
        x[where] = value

    return change


def without(ranges: SatelliteRanges, *where: Any) -> SatelliteRanges:
    return changed(ranges, has_range=put(0.0, *where), has_rate=put(0.0, *where))


@pytest.fixture(scope="session")
def spoil() -> SimpleNamespace:
    """What changes ranges, by channel, and where in a channel."""
    return SimpleNamespace(changed=changed, add=add, put=put, without=without)
