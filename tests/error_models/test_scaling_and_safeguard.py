import math

import numpy as np
import pytest
import torch

from navlearn.error_models.safeguard import (
    clamp_and_standardise,
    count_outside,
    rolling_origin_gate,
)
from navlearn.error_models.scaling import fit_scaling
from navlearn.errors import FitError, ShapeError


def test_scaling_equals_weighted_moments():
    rng = np.random.default_rng(0)
    values, weight = rng.normal(3.0, [1.0, 5.0], (4, 30, 2)), rng.uniform(0, 1, (4, 30))
    weight[0] = 0.0
    values[0] = np.nan
    scaling = fit_scaling(torch.tensor(values), torch.tensor(weight))
    rows, share = values[1:].reshape(-1, 2), weight[1:].reshape(-1)
    mean = np.average(rows, axis=0, weights=share)
    spread = np.sqrt(np.average((rows - mean) ** 2, axis=0, weights=share))
    np.testing.assert_allclose(scaling.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(scaling.scale, spread, rtol=1e-12)
    np.testing.assert_array_equal(scaling.low, rows.min(0))
    np.testing.assert_array_equal(scaling.high, rows.max(0))


def test_a_channel_that_never_moves_has_unit_scale():
    values = torch.full((50, 2), 0.1, dtype=torch.float64)
    values[:, 1] = torch.arange(50)
    scaling = fit_scaling(values, torch.ones(50).double())
    assert float(scaling.scale[0]) == 1.0
    assert float(scaling.mean[0]) == pytest.approx(0.1)


def test_scaling_refuses():
    values = torch.zeros(5, 2).double()
    with pytest.raises(ShapeError, match="without its last axis"):
        fit_scaling(values, torch.ones(4).double())
    with pytest.raises(FitError, match="positive weight"):
        fit_scaling(values, torch.zeros(5).double())
    with pytest.raises(FitError, match="not finite"):
        fit_scaling(values * torch.inf, torch.ones(5).double())


def test_clamping_and_counting_agree():
    low, high = torch.tensor([-1.0, 0.0]), torch.tensor([1.0, 2.0])
    values = torch.tensor([[0.0, 1.0], [-3.0, 2.0], [torch.nan, 7.0], [1.0, torch.inf]])
    mean, scale = torch.tensor([0.5, 1.0]), torch.tensor([2.0, 0.5])
    held = clamp_and_standardise(values, low, high, mean, scale)
    expected = torch.tensor([[0.0, 1.0], [-1.0, 2.0], [0.5, 2.0], [1.0, 2.0]])
    assert torch.equal(held, (expected - mean) / scale)
    assert count_outside(values, low, high).tolist() == [0, 1, 2, 1]


def test_gate_compares_means_and_asks_for_enough_replays():
    without = torch.tensor([1.0, 1.0, 1.0, 1.0, 96.0]).double()
    # Worse four times out of five, yet better where it matters.
    verdict = rolling_origin_gate(torch.tensor([2.0, 2, 2, 2, 42]).double(), without)
    assert verdict.use
    assert verdict.improvement == pytest.approx(0.5)
    assert not rolling_origin_gate(0.97 * without, without).use
    assert rolling_origin_gate(0.97 * without, without, margin=0.02).use
    assert not rolling_origin_gate(without[:4] * 0.1, without[:4]).use
    empty = rolling_origin_gate(without[:0], without[:0])
    assert not empty.use
    assert math.isnan(empty.improvement)
    with pytest.raises(ShapeError, match="a value per replay"):
        rolling_origin_gate(without[:3], without)
