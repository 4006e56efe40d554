"""Keplerian orbits: a second transcription, two bodies integrated, and exact derivatives."""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from torch import Tensor

from navlearn.gnss.ephemeris import EARTH_RATE, GRAVITATION, KeplerEphemeris
from navlearn.gnss.kepler import eccentric_anomaly, kepler_state

Array = NDArray[np.float64]
LIGHT = 299792458.0
FIELDS = KeplerEphemeris._fields
PLAIN = {
    "sqrt_a": math.sqrt(2.656e7),
    "mean_anomaly": 0.4,
    "perigee": -1.1,
    "inclination": 0.96,
    "node": 2.2,
    "gravitation": GRAVITATION["G"],
    "earth_rate": EARTH_RATE["G"],
}
FULL = PLAIN | {
    "toe": 388800.0,
    "toe_of_week": 388800.0,
    "toc": 388784.0,
    "clock_bias": -4.1e-4,
    "clock_drift": 3.2e-12,
    "clock_drift_rate": 1e-19,
    "group_delay": -1.1e-8,
    "eccentricity": 0.0123,
    "mean_motion_difference": 4.6e-9,
    "inclination_rate": 2e-10,
    "node_rate": -8.1e-9,
    "cuc": 1.2e-6,
    "cus": 8.8e-6,
    "crc": 210.0,
    "crs": -45.0,
    "cic": 1.1e-7,
    "cis": -6e-8,
}


def ephemeris(told: dict[str, float]) -> KeplerEphemeris:
    values = (told.get(name, 0.0) for name in FIELDS)
    return KeplerEphemeris(*(torch.tensor(value, dtype=torch.float64) for value in values))


def drawn(count: int, seed: int = 2) -> KeplerEphemeris:
    """Return messages about :data:`FULL`, half of them in tilted axes."""
    generator = torch.Generator().manual_seed(seed)
    spread = {"mean_anomaly": 3.0, "node": 3.0, "perigee": 3.0, "eccentricity": 0.01}
    fields = []
    for name in FIELDS:
        draw = 2.0 * torch.rand(count, generator=generator, dtype=torch.float64) - 1.0
        value = torch.full((count,), FULL.get(name, 0.0), dtype=torch.float64)
        fields.append(value + spread.get(name, 0.0) * draw)
    tilted = (torch.arange(count) % 2).to(torch.float64)
    return KeplerEphemeris(*fields)._replace(tilted=tilted)


def interface_document(told: dict[str, float], t: float) -> tuple[Array, float]:
    """Return position (m) and clock (s), written down anew with rotations and a root finder."""
    tk = t - told["toe"]
    axis = told["sqrt_a"] ** 2
    e = told["eccentricity"]
    mean = told["mean_anomaly"] + tk * (
        math.sqrt(told["gravitation"] / axis**3) + told["mean_motion_difference"]
    )
    anomaly = brentq(lambda x: x - e * math.sin(x) - mean, mean - 1, mean + 1, xtol=1e-15)
    true = 2 * math.atan(math.sqrt((1 + e) / (1 - e)) * math.tan(anomaly / 2))
    phi = true + told["perigee"]
    wave = np.array([math.cos(2 * phi), math.sin(2 * phi)])
    u = phi + wave @ [told["cuc"], told["cus"]]
    r = axis * (1 - e * math.cos(anomaly)) + wave @ [told["crc"], told["crs"]]
    i = told["inclination"] + told["inclination_rate"] * tk + wave @ [told["cic"], told["cis"]]
    node = (
        told["node"]
        + (told["node_rate"] - told["earth_rate"]) * tk
        - told["earth_rate"] * told["toe_of_week"]
    )
    position = Rotation.from_euler("ZXZ", [node, i, u]).apply([r, 0.0, 0.0])
    since = t - told["toc"]
    clock = (
        told["clock_bias"]
        + told["clock_drift"] * since
        + told["clock_drift_rate"] * since**2
        - 2 * math.sqrt(told["gravitation"]) / LIGHT**2 * e * told["sqrt_a"] * math.sin(anomaly)
    )
    return position, clock - told["group_delay"]


def test_against_a_second_transcription() -> None:
    t = 388800.0 + np.linspace(-7200.0, 7200.0, 13)
    state = kepler_state(ephemeris(FULL), torch.tensor(t))
    for k, at in enumerate(t):
        position, clock = interface_document(FULL, at)
        np.testing.assert_allclose(state.position[k].numpy(), position, atol=1e-6, rtol=0)
        assert float(state.clock[k]) / LIGHT == pytest.approx(clock, abs=1e-17)


@pytest.mark.parametrize("eccentricity", [0.0, 0.02, 0.16])
def test_against_two_bodies_integrated(eccentricity: float) -> None:
    """Newton's law in space, turned with the Earth, gives position and velocity."""
    told = PLAIN | {"eccentricity": eccentricity, "node": 0.3}
    start = kepler_state(ephemeris(told), torch.tensor(0.0, dtype=torch.float64))
    spin = np.array([0.0, 0.0, told["earth_rate"]])
    position, velocity = start.position.numpy(), start.velocity.numpy()

    def newton(_: float, y: Array) -> Array:
        return np.concatenate((y[3:], -told["gravitation"] / np.linalg.norm(y[:3]) ** 3 * y[:3]))

    inertial = np.concatenate((position, velocity + np.cross(spin, position)))
    times = np.linspace(0.0, 14400.0, 9)
    path = solve_ivp(newton, (0.0, 14400.0), inertial, "DOP853", times, rtol=1e-13, atol=1e-6).y.T
    state = kepler_state(ephemeris(told), torch.tensor(times))
    for k, at in enumerate(times):
        turned = Rotation.from_rotvec(-spin * at)
        np.testing.assert_allclose(
            state.position[k].numpy(), turned.apply(path[k, :3]), atol=1e-4, rtol=0
        )
        against_earth = turned.apply(path[k, 3:] - np.cross(spin, path[k, :3]))
        np.testing.assert_allclose(state.velocity[k].numpy(), against_earth, atol=1e-8, rtol=0)


def test_a_circular_orbit_has_its_radius_speed_and_period() -> None:
    told = PLAIN | {"gravitation": 3.986005e14, "earth_rate": 0.0}
    axis = told["sqrt_a"] ** 2
    period = 2 * math.pi * math.sqrt(axis**3 / 3.986005e14)
    times = torch.tensor([0.0, 0.25, 1.0], dtype=torch.float64) * period
    state = kepler_state(ephemeris(told), times)
    norms = torch.linalg.vector_norm(state.position, dim=-1)
    torch.testing.assert_close(norms, torch.full((3,), axis, dtype=torch.float64))
    speed = torch.linalg.vector_norm(state.velocity, dim=-1)
    expected = math.sqrt(3.986005e14 / axis)
    torch.testing.assert_close(speed, torch.full((3,), expected, dtype=torch.float64))
    torch.testing.assert_close(state.position[2], state.position[0], atol=1e-6, rtol=0)
    assert abs(float(state.position[0] @ state.position[1])) < 1e-6 * axis**2


def test_velocity_and_clock_rate_are_the_derivatives() -> None:
    told = drawn(40)
    t = torch.linspace(381600.0, 396000.0, 40, dtype=torch.float64)
    state = kepler_state(told, t)

    def value(at: Tensor) -> tuple[Tensor, Tensor]:
        moved = kepler_state(told, at)
        return moved.position, moved.clock

    _, (velocity, clock_rate) = torch.func.jvp(value, (t,), (torch.ones_like(t),))
    torch.testing.assert_close(state.velocity, velocity, atol=1e-8, rtol=0)
    torch.testing.assert_close(state.clock_rate, clock_rate, atol=1e-13, rtol=0)
    before, after = kepler_state(told, t - 1.0), kepler_state(told, t + 1.0)
    middle = 0.5 * (after.position - before.position)
    torch.testing.assert_close(state.velocity, middle, atol=1e-4, rtol=0)


def test_a_geostationary_satellite_of_beidou_stands_still() -> None:
    """An equatorial orbit as it is told in axes tilted by five degrees."""
    rate, gm = EARTH_RATE["C"], GRAVITATION["C"]
    axis = (gm / rate**2) ** (1 / 3)
    told = {
        "sqrt_a": math.sqrt(axis),
        "inclination": math.radians(5.0),
        "node": math.pi,
        "mean_anomaly": 1.0,
        "gravitation": gm,
        "earth_rate": rate,
        "tilted": 1.0,
    }
    state = kepler_state(ephemeris(told), torch.linspace(-7200.0, 86400.0, 7).double())
    still = state.position[:1].expand(7, 3)
    torch.testing.assert_close(state.position, still, atol=1e-5, rtol=0)
    assert state.position[:, 2].abs().max() < 1e-6
    assert state.velocity.abs().max() < 1e-9
    assert torch.linalg.vector_norm(state.position[0]) == pytest.approx(42164e3, rel=1e-4)


def test_relativity_by_the_product_of_position_and_velocity() -> None:
    """−2 r·v / c² is the same periodic term, [ISGPS200] §20.3.3.3.3.1, with v in space."""
    told = PLAIN | {"eccentricity": 0.02, "earth_rate": 0.0}
    state = kepler_state(ephemeris(told), torch.linspace(0.0, 43000.0, 11).double())
    product = (state.position * state.velocity).sum(-1)
    torch.testing.assert_close(state.clock, -2.0 * product / LIGHT, atol=1e-9, rtol=0)
    assert state.clock.abs().max() > 10.0


def test_across_the_change_of_weeks() -> None:
    """Seconds of week and GPS seconds tell the same, before and after midnight of Saturday."""
    week = 2268 * 604800.0
    of_week = FULL | {"toe": 604784.0, "toe_of_week": 604784.0, "toc": 604784.0}
    whole = of_week | {"toe": week + 604784.0, "toc": week + 604784.0}
    for late in (-100.0, 0.0, 3000.0):
        wrapped = torch.remainder(torch.tensor(604800.0 + late, dtype=torch.float64), 604800.0)
        by_week = kepler_state(ephemeris(of_week), wrapped)
        by_gps = kepler_state(
            ephemeris(whole), torch.tensor(week + 604800.0 + late, dtype=torch.float64)
        )
        # ten-digit seconds are rounded by a tenth of a microsecond
        torch.testing.assert_close(by_week.position, by_gps.position, atol=1e-3, rtol=0)
        torch.testing.assert_close(by_week.clock, by_gps.clock, atol=1e-8, rtol=0)
        expected, _ = interface_document(of_week, 604800.0 + late)
        np.testing.assert_allclose(by_week.position.numpy(), expected, atol=1e-5, rtol=0)


def test_batch_equals_loop() -> None:
    told = drawn(6)
    t = torch.linspace(381600.0, 396000.0, 4, dtype=torch.float64)
    together = kepler_state(told, t.unsqueeze(-1))
    assert together.position.shape == (4, 6, 3)
    for k in range(6):
        one = KeplerEphemeris(*(field[k] for field in told))
        for j in range(4):
            alone = kepler_state(one, t[j])
            for batched, single in zip(together, alone, strict=True):
                torch.testing.assert_close(batched[j, k], single, atol=1e-7, rtol=1e-14)


def test_streaming_code_can_script_it() -> None:
    told = drawn(3)
    t = torch.tensor([385000.0, 388800.0, 392000.0], dtype=torch.float64)
    scripted = torch.jit.script(kepler_state)(told, t)
    torch.testing.assert_close(tuple(scripted), tuple(kepler_state(told, t)))


def test_eccentric_anomaly_by_a_root_finder() -> None:
    for e in (0.0, 0.01, 0.2, 0.3):
        mean = np.linspace(0.0, 2 * np.pi, 21)
        found = eccentric_anomaly(torch.tensor(mean), torch.tensor(e, dtype=torch.float64))
        expected = [
            brentq(lambda x, m=m, e=e: x - e * math.sin(x) - m, -1, 8, xtol=1e-15) for m in mean
        ]
        np.testing.assert_allclose(found.numpy(), expected, atol=5e-15, rtol=0)


def test_gradients_to_every_element() -> None:
    told = drawn(2)
    t = torch.tensor([390000.0, 385000.0], dtype=torch.float64)
    elements = ("eccentricity", "mean_anomaly", "perigee", "inclination", "node", "cus", "cis")
    inputs = [getattr(told, name).clone().requires_grad_() for name in elements]

    def scaled(*parts: Tensor) -> tuple[Tensor, ...]:
        state = kepler_state(told._replace(**dict(zip(elements, parts, strict=True))), t)
        return state.position / 1e7, state.velocity / 1e3, state.clock, state.clock_rate * 1e3

    assert torch.autograd.gradcheck(scaled, inputs, eps=1e-6, atol=1e-5)
