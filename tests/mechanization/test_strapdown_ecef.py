"""The way to the Earth-centred frame and back, against the frames of the package."""

import torch

from navlearn import attitude, frames
from navlearn.mechanization.coning import coning_sculling
from navlearn.mechanization.strapdown_ecef import ecef_in_turn, ecef_step, from_ecef, to_ecef
from navlearn.states import InsState


def test_conversion_equals_that_of_the_frames_and_returns(ins_start):
    state = ins_start(5)
    state = state._replace(lon=torch.remainder(state.lon + 3.0, 6.2) - 3.1)
    found = to_ecef(state)
    position = frames.ecef_from_geodetic(state.lat, state.lon, state.height)
    torch.testing.assert_close(found.position, position, rtol=0, atol=2e-9)
    to_earth = frames.enu_from_ecef_matrix(state.lat, state.lon).transpose(-1, -2)
    v = torch.einsum("nij,nj->ni", to_earth, state.v_l)
    torch.testing.assert_close(found.velocity, v, rtol=0, atol=1e-13)
    C_eb = to_earth @ attitude.matrix_from_quaternion(state.q_lb)
    torch.testing.assert_close(
        attitude.matrix_from_quaternion(found.q_eb), C_eb, rtol=0, atol=1e-14
    )
    back = from_ecef(found)
    for a, b, metres in zip(back, state, (6.4e6, 6.4e6, 1.0, 1.0, 1.0), strict=True):
        assert float((a - b).abs().max()) * metres < 1e-8


def test_a_parked_car_stays_parked(parked):
    start, samples = parked(200, 0.5)
    ecef = to_ecef(start)
    increments = coning_sculling(samples.omega_ib_b, samples.f_b, samples.dt)
    found = torch.jit.script(ecef_in_turn)(ecef, *increments, samples.dt)
    assert float((found.position - ecef.position.unsqueeze(1)).abs().max()) < 1e-5
    assert float(found.velocity.abs().max()) < 1e-7
    back = from_ecef(found)
    assert isinstance(back, InsState)
    assert float((back.q_lb - start.q_lb.unsqueeze(1)).abs().max()) < 1e-12


def test_step_passes_gradcheck(ins_start):
    state = to_ecef(ins_start(2))

    def step(position, *others):
        found = ecef_step(state._replace(position=1e3 * position, **named(others)), *others[2:])
        return found.position / 1e3, found.velocity, found.q_eb

    def named(others):
        return {"velocity": others[0], "q_eb": others[1]}

    turn, push = torch.tensor(((0.03, -0.02, 0.1), (1.0, 0.5, 4.9))).double().unsqueeze(1).unbind(0)
    inputs = (
        state.position / 1e3,
        *state[1:],
        turn.repeat(2, 1),
        push.repeat(2, 1),
        torch.tensor((0.5, 0.01), dtype=torch.float64),
    )
    inputs = tuple(x.clone().requires_grad_() for x in inputs)
    assert torch.autograd.gradcheck(step, inputs, eps=1e-5, atol=1e-6, rtol=1e-6)
