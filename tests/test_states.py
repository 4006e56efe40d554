"""States travel: through scripting, vmap and replacement of one field."""

import torch

from navlearn.states import (
    FixTiming,
    GnssFix,
    ImuSample,
    InsState,
    NavState,
    RissSample,
    Trajectory,
)


def _fill(kind, shape):
    return kind(
        *(torch.full(shape, float(k), dtype=torch.float64) for k, _ in enumerate(kind._fields))
    )


@torch.jit.script
def _pass_on(state: NavState, sample: RissSample, fix: GnssFix, timing: FixTiming) -> NavState:
    return NavState(
        state.lat + sample.dt, state.lon + fix.std_v, state.height + timing.delay, state.azimuth
    )


def test_every_state_travels_through_a_scripted_function():
    shape = (2, 3)
    found = _pass_on(*(_fill(kind, shape) for kind in (NavState, RissSample, GnssFix, FixTiming)))
    expected = (0.0, 1.0 + GnssFix._fields.index("std_v"), 2.0 + 1.0, 3.0)
    assert [x.unique().item() for x in found] == list(expected)


def test_states_are_pytrees_to_vmap():
    moved = torch.func.vmap(lambda s: s._replace(lat=s.lat + s.lon))(_fill(NavState, (4,)))
    assert isinstance(moved, NavState)
    assert moved.lat.tolist() == [1.0] * 4


def test_a_trajectory_starts_with_the_fields_of_a_state():
    assert Trajectory._fields[:4] == NavState._fields


@torch.jit.script
def _moved(state: InsState, sample: ImuSample) -> InsState:
    return InsState(
        state.lat, state.lon, state.height, state.v_l + sample.f_b * sample.dt, state.q_lb
    )


def test_a_full_imu_travels_through_a_scripted_function():
    found = _moved(_fill(InsState, (3,)), _fill(ImuSample, (3,))._replace(dt=torch.tensor(0.5)))
    assert found.v_l.tolist() == [3.0 + 2.0 * 0.5] * 3
