"""Dilution of precision against closed cases and NumPy."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navlearn.gnss.dilution import dilution


def units(elevation: list[float], azimuth: list[float]) -> torch.Tensor:
    e, a = (torch.tensor(part, dtype=torch.float64) for part in (elevation, azimuth))
    return torch.stack((e.cos() * a.sin(), e.cos() * a.cos(), e.sin()), dim=-1)


def test_one_overhead_and_three_on_the_horizon() -> None:
    """The best geometry of four: HDOP² = 4/3, VDOP² = 4/3, TDOP² = 1/3."""
    third = 2.0 * math.pi / 3.0
    unit = units([0.5 * math.pi, 0.0, 0.0, 0.0], [0.0, 0.0, third, 2.0 * third])
    found = dilution(unit, torch.ones(4))
    for value, square in zip(found, (3.0, 8.0 / 3.0, 4.0 / 3.0, 4.0 / 3.0, 1.0 / 3.0), strict=True):
        assert float(value) == pytest.approx(math.sqrt(square))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), satellites=st.integers(6, 14), systems=st.integers(1, 2))
def test_as_numpy_has_it(seed: int, satellites: int, systems: int) -> None:
    draw = np.random.default_rng(seed)
    elevation = draw.uniform(0.1, 1.5, satellites).tolist()
    unit = units(elevation, draw.uniform(0.0, 6.28, satellites).tolist())
    system = np.arange(satellites) % systems
    design = np.column_stack((-unit.numpy(), np.eye(systems)[system]))
    q = np.diag(np.linalg.inv(design.T @ design))
    found = dilution(unit, torch.ones(satellites), torch.tensor(system))
    expected = [q.sum(), q[:3].sum(), q[:2].sum(), q[2], q[3]]
    np.testing.assert_allclose([float(value) for value in found], np.sqrt(expected), rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_one_more_satellite_never_harms(seed: int) -> None:
    draw = np.random.default_rng(seed)
    unit = units(draw.uniform(0.1, 1.5, 7).tolist(), draw.uniform(0.0, 6.28, 7).tolist())
    visible = torch.ones(2, 7)
    visible[0, 6] = 0.0
    for value in dilution(unit.expand(2, 7, 3), visible):
        assert float(value[1]) <= float(value[0]) * (1.0 + 1e-9)


def test_infinite_where_satellites_do_not_suffice() -> None:
    unit = units([0.3, 0.5, 0.7, 1.2], [0.0, 2.0, 4.0, 5.0]).expand(4, 4, 3).clone()
    visible = torch.ones(4, 4)
    visible[0] = 0.0
    visible[1, 3] = 0.0
    unit[2] = unit[2, :1]
    for value in dilution(unit, visible):
        assert torch.isinf(value[:3]).all()
        assert torch.isfinite(value[3])


def test_clock_of_a_system_that_is_not_received() -> None:
    unit = units([0.3, 0.5, 0.7, 1.2], [0.0, 2.0, 4.0, 5.0])
    second = dilution(unit, torch.ones(4), torch.tensor([1, 1, 1, 1]))
    only = dilution(unit, torch.ones(4))
    assert float(second.pdop) == pytest.approx(float(only.pdop))
    assert math.isinf(float(second.tdop))


def test_as_rtklib_has_it() -> None:
    rtklib = pytest.importorskip("pyrtklib")
    draw = np.random.default_rng(5)
    elevation, azimuth = draw.uniform(0.2, 1.5, 9), draw.uniform(0.0, 6.28, 9)
    azel, dop = rtklib.Arr1Ddouble(18), rtklib.Arr1Ddouble(4)
    for k in range(9):
        azel[2 * k], azel[2 * k + 1] = azimuth[k], elevation[k]
    rtklib.dops(9, azel, 0.0, dop)
    found = dilution(units(elevation.tolist(), azimuth.tolist()), torch.ones(9))
    np.testing.assert_allclose([float(v) for v in found[:4]], [dop[k] for k in range(4)], rtol=1e-9)
