import numpy as np
import pandas as pd

from navlearn.logs.fix_tensors import FixOptions, fixes_from_table

EDGES = np.arange(101) / 10.0


def place(options=None, **columns):
    return fixes_from_table(pd.DataFrame(columns), EDGES, options or FixOptions())


def test_fixes_fall_on_the_nearest_end():
    t = [0.0, 0.05, 0.149, 0.151, 5.04, 10.04, 10.06]
    _, timing, fix_time = place(t=t, lat=[0.7] * 7, lon=[0.1] * 7)
    assert timing.index.tolist() == [0, 0, 0, 1, 49, 99]
    np.testing.assert_allclose(timing.delay, [0.1, 0.05, -0.049, 0.049, -0.04, -0.04], atol=1e-12)
    np.testing.assert_allclose(fix_time, t[:6])


def test_fixes_before_the_grid_are_left_out():
    fixes, timing, fix_time = place(t=[-0.3, -0.01], lat=[0.7, 0.7], lon=[0.1, 0.1])
    assert fixes.lat.shape == timing.index.shape == fix_time.shape == (0,)


def test_assumed_and_least_standard_deviations():
    fixes, _, _ = place(t=[1.0, 2.0], lat=[0.7] * 2, lon=[0.1] * 2, std_e=[np.nan, 0.0])
    assert fixes.std_e.tolist() == [2.0, 0.05]
    assert fixes.std_n.tolist() == [2.0, 2.0]
    assert fixes.std_v.tolist() == [0.1, 0.1]
    assert fixes.std_u.tolist() == [1000.0, 1000.0]
    wish = FixOptions(std_horizontal=7.0, std_velocity=0.5)
    fixes, _, _ = place(wish, t=[1.0], lat=[0.7], lon=[0.1], height=[50.0])
    assert (fixes.std_n[0], fixes.std_v[0], fixes.std_u[0]) == (7.0, 0.5, 4.0)


def test_what_is_missing_is_said_to_be_missing():
    fixes, _, _ = place(
        t=[1.0, 2.0, 3.0],
        lat=[0.7, np.nan, 0.71],
        lon=[0.1, np.nan, 0.11],
        v_e=[np.nan, 2.0, 3.0],
        v_n=[1.0, 1.0, 1.0],
    )
    assert fixes.has_position.tolist() == [1.0, 0.0, 1.0]
    assert fixes.has_velocity.tolist() == [0.0, 1.0, 1.0]
    # Held from the past, not filled from the future.
    assert fixes.lat.tolist() == [0.7, 0.7, 0.71]
    assert all(np.isfinite(channel.numpy()).all() for channel in fixes)
