"""Errors as large as the tight filter says: drives, clocks and ranges drawn from its own model."""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.filters.consistency import chi_square_quantile
from navlearn.frames import enu_between
from navlearn.fusion.measurements import Verdict
from navlearn.fusion.tight.module import TightEkf
from navlearn.fusion.tight.options import RangeGateOptions, TightEkfOptions
from navlearn.fusion.tight.riss_vehicle import RissVehicle
from navlearn.gnss.range_noise import RangeNoiseOptions

WHITE = RangeNoiseOptions(multipath_time=0.0)

GROUPS = {
    "position": [0, 1, 2],
    "azimuth": [3],
    "sensors": [4, 5, 6],
    "clock": [7, 8],
    "offset": [9],
    "all": list(range(10)),
}


def measured(
    runs: int,
    seconds: int,
    satellites: int,
    make_drive: Callable[..., Any],
    model_drives: Callable[..., Any],
    make_ranges: Callable[..., Any],
    make_clock: Callable[..., Any],
    make_car: Callable[..., Any],
) -> tuple[dict[str, Tensor], Any]:
    """NEES per group, shape (runs, K), and the history."""
    options, start, d, sensor = model_drives(runs, seconds, 11)
    time = torch.arange(1.0, seconds + 1, dtype=torch.float64)
    clock, drift = make_clock(time, runs, 5)
    at = [torch.gather(x, 1, d.timing.index) for x in d.truth[:3]]
    # the same cars with fixes that measure velocity without error
    true = make_drive(seconds=seconds, rate=10, batch=runs, seed=5, velocity_sigma=0.0).fixes
    v = torch.stack((true.v_e, true.v_n, true.v_u), -1)
    ranges = make_ranges(
        make_car(*at, v),
        time,
        clock,
        drift,
        satellites,
        (0.0, 120.0),
        WHITE,
        3,
    )
    options = type(options)(**{**vars(options), "position": False, "velocity": False})
    gate = RangeGateOptions(probability=1.0)
    tight = TightEkfOptions(gate=gate, range_noise=WHITE)
    ekf = TightEkf(RissVehicle(options), tight, systems=2)
    with torch.no_grad():
        history = ekf(start, d.samples, ranges, d.timing)
    belief, there = history.belief, history.reception[0] >= 0
    state = belief.vehicle.state
    place = torch.stack(enu_between(*(x[:, there] for x in state[:3]), *at), -1)
    azimuth = torch.gather(d.truth.azimuth, 1, d.timing.index)
    turned = (state.azimuth[:, there] - azimuth).unsqueeze(-1)
    own = belief.vehicle.sensor[:, there] - sensor
    offset = torch.full_like(clock, 120.0)
    behind = belief.clock[:, there] - torch.stack((clock, drift, offset), -1)
    error = torch.cat((place, turned, own, behind), -1)
    P = belief.covariance[:, there]
    found = {}
    for name, which in GROUPS.items():
        e, part = error[..., which], P[..., which, :][..., which]
        found[name] = (e * torch.linalg.solve(part, e.unsqueeze(-1)).squeeze(-1)).sum(-1)
    return found, history


def check(found: dict[str, Tensor], history: Any, runs: int, wide: float) -> None:
    ratios = {}
    for name, which in GROUPS.items():
        n, later = len(which), found[name][:, 5:-1]
        # receptions of a run hang together: the band is that of one moment's mean over runs,
        # narrowed by what a run holds of independent moments
        ratios[name] = float(later.mean()) / n
        band = wide * np.sqrt(2.0 / (n * runs))
        assert abs(ratios[name] - 1.0) < band, (name, ratios[name], band)
    fine = history.verdict[:, 5:-1] == Verdict.ACCEPTED
    count = fine.shape[-1] // 2
    for name, part in (("range", slice(0, count)), ("rate", slice(count, 2 * count))):
        nis = history.nis[:, 5:-1, part][fine[..., part]]
        ratios[name] = float(nis.mean())
        # the innovations of a filter that is right are white in time, not among satellites
        band = wide * np.sqrt(2.0 / (nis.numel() / count))
        assert abs(ratios[name] - 1.0) < band + 0.02, (name, ratios[name], band)
        share = float((nis > chi_square_quantile(0.95, 1)).double().mean())
        assert 0.03 < share < 0.07
    # pytest --log-cli-level=INFO shows them
    logging.info(" ".join(f"{name} {ratio:.3f}" for name, ratio in ratios.items()))


def test_errors_are_as_large_as_told(
    make_drive: Any, model_drives: Any, make_ranges: Any, make_clock: Any, make_car: Any
) -> None:
    found, history = measured(
        48, 30, 8, make_drive, model_drives, make_ranges, make_clock, make_car
    )
    check(found, history, 48, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("satellites", [8, 5, 3])
def test_errors_are_as_large_as_told_over_many_drives(
    satellites: int,
    make_drive: Any,
    model_drives: Any,
    make_ranges: Any,
    make_clock: Any,
    make_car: Any,
) -> None:
    found, history = measured(
        400, 90, satellites, make_drive, model_drives, make_ranges, make_clock, make_car
    )
    check(found, history, 400, 3.0)
