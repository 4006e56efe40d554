"""A start that knows hardly anything of azimuth: who finds it, extended or unscented filter."""

import math
import sys
import warnings
from typing import Any

import torch
from torch import Tensor

from navlearn.filters.tight_belief import map_tree
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.filters_of import ins_filter
from navlearn.fusion.ins.layout import moved_belief, state_difference
from navlearn.fusion.ins.options import InsEkfOptions, InsInitialOptions
from navlearn.fusion.ins.start import initial_ins_belief
from navlearn.states import InsState

ERRORS = (60.0, 120.0, -120.0, 150.0, 180.0)
UNKNOWN = math.pi / math.sqrt(3.0)
"""Deviation of an azimuth that may be anything, rad."""

NARROW = UnscentedOptions(alpha=0.35)
"""Points 1.4 deviations from the mean: farther out they would meet behind the car."""


def found(d: Any, unscented: UnscentedOptions | None, **more: Any) -> Tensor:
    """Azimuth errors after each block, deg, from starts that err by ERRORS, shape (B, K)."""
    options = InsEkfOptions(unscented=unscented, initial=InsInitialOptions(azimuth=UNKNOWN), **more)
    count = len(ERRORS)
    start, truth, samples, fixes, timing = map_tree(
        tuple(d), lambda x: x.expand(count, *x.shape).clone()
    )
    wrong = torch.zeros(count, initial_ins_belief(options, start).sensor.shape[-1] + 9).double()
    # an azimuth error is −φ_up
    wrong[:, 8] = -torch.tensor(ERRORS, dtype=torch.float64) * math.pi / 180.0
    belief = moved_belief(initial_ins_belief(options, start), wrong)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # innovations of a car turned round are large
        history = ins_filter(options)(belief, samples, fixes, timing)
    rows = torch.arange(count).unsqueeze(-1)
    at = InsState(*(channel[rows, history.end] for channel in truth))
    return state_difference(history.belief.state, at)[..., 8].abs() * 180.0 / math.pi


def test_behind_the_gate_points_find_an_azimuth_that_a_tangent_does_not(
    make_drive: Any, lever_arm: Any
) -> None:
    """The gate refuses what a filter that is sure of a wrong azimuth does not foresee.

    Turned right round neither finds back soon: backwards is an equilibrium for odometer and axle.
    """
    d = make_drive(seconds=24, rate=20, seed=2)
    points, tangent = (found(d, u, lever_arm=lever_arm)[:, -1] for u in (NARROW, None))
    sys.stdout.write(f"unscented {points.tolist()}, extended {tangent.tolist()}\n")
    assert float(points[:3].max()) < 2.0
    assert float(tangent[1:3].max()) > 10.0
