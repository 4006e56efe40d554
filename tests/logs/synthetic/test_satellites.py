"""Constellations and what they send, beside circles, inertial axes and finite differences."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from navlearn import frames, wgs84
from navlearn.gnss.ephemeris import KeplerEphemeris
from navlearn.gnss.kepler import kepler_state
from navlearn.gnss.signals import SPEED_OF_LIGHT
from navlearn.logs.synthetic.satellites import EPOCH, PATTERNS, constellation, signals

WEEK = 604800.0
SIDEREAL_DAY = 2.0 * math.pi / wgs84.EARTH_RATE
DAY = np.arange(0.0, 86400.0, 300.0)


def about_z(angle: float) -> np.ndarray:
    """Return the matrix that turns vectors by an angle, from x to y."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def circle(system: str, number: int, elapsed: float) -> np.ndarray:
    """Return where a satellite on a circle is, in axes that stand still and were Earth's at EPOCH.

    Turns of plane after plane, by nothing but rotations.
    """
    pattern = PATTERNS[system]
    plane, place = divmod(number, pattern.per_plane)
    count = pattern.planes * pattern.per_plane
    along = 2.0 * math.pi * (place / pattern.per_plane + plane * pattern.phase / count)
    along += elapsed * math.sqrt(3.986004418e14 / pattern.semi_major_axis**3)
    node = pattern.first_node + 2.0 * math.pi * plane / pattern.planes
    s, c = math.sin(pattern.inclination), math.cos(pattern.inclination)
    tilt = np.array(((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)))
    return pattern.semi_major_axis * (about_z(node) @ tilt @ about_z(along))[:, 0]


def circles(orbits: KeplerEphemeris) -> KeplerEphemeris:
    """Return the orbits with no eccentricity; the anomaly then counts from the perigee."""
    return orbits._replace(eccentricity=torch.zeros_like(orbits.eccentricity))


@pytest.mark.parametrize("system", list(PATTERNS))
@pytest.mark.parametrize("start", [EPOCH + 1234.0, EPOCH + 3.4 * WEEK])
def test_circles_are_where_rotations_put_them(system: str, start: float) -> None:
    names, orbits = constellation(system, start)
    week = math.floor(start / WEEK) * WEEK
    for later in (0.0, 5000.0, 40000.0):
        at = torch.tensor(start - week + later, dtype=torch.float64)
        found = kepler_state(circles(orbits), at).position.numpy()
        elapsed = start + later - EPOCH
        turn = about_z(-wgs84.EARTH_RATE * elapsed)
        expected = np.stack([turn @ circle(system, n, elapsed) for n in range(len(names))])
        # The phase after some million seconds is a large number: a tenth of a millimetre.
        np.testing.assert_allclose(found, expected, atol=1e-3)


def test_names_and_energy() -> None:
    for system, count in (("G", 30), ("E", 24), ("R", 24)):
        names, orbits = constellation(system, EPOCH)
        assert names[0] == f"{system}01"
        assert len(set(names)) == len(names) == count
        assert float(orbits.eccentricity.max()) <= PATTERNS[system].eccentricity < 0.02
        state = kepler_state(orbits, torch.tensor(DAY)[:, None])
        x, v = state.position.numpy(), state.velocity.numpy()
        inertial = v + np.cross([0.0, 0.0, wgs84.EARTH_RATE], x)
        radius, a = np.linalg.norm(x, axis=-1), PATTERNS[system].semi_major_axis
        energy = (inertial**2).sum(-1) / 2.0 - 3.986004418e14 / radius
        np.testing.assert_allclose(energy, -3.986004418e14 / (2.0 * a), rtol=1e-10)
        assert (np.abs(radius / a - 1.0).max(axis=0) <= orbits.eccentricity.numpy() + 1e-12).all()
        assert not state.clock[:, orbits.eccentricity == 0.0].any()


def test_gps_passes_every_place_once_a_sidereal_day() -> None:
    _, orbits = constellation("G", EPOCH)
    state = [
        kepler_state(orbits, torch.tensor(t, dtype=torch.float64)).position
        for t in (0.0, SIDEREAL_DAY)
    ]
    # Ten seconds of its way: the semi-major axis is that of disturbed orbits.
    assert float((state[1] - state[0]).norm(dim=-1).max()) < 50e3


def test_travel_and_rate_are_those_of_inertial_axes() -> None:
    _, orbits = constellation("G", EPOCH + 500.0)
    lat, lon, height = 0.77, -1.33, 120.0
    v_l = np.array((21.0, -13.0, 0.7))
    found = signals(
        orbits,
        np.array((700.0,)),
        (np.array((lat,)), np.array((lon,)), np.array((height,))),
        v_l[None],
    )
    place = [torch.tensor(x, dtype=torch.float64) for x in (lat, lon, height)]
    start = frames.ecef_from_geodetic(*place).numpy()
    velocity = frames.enu_from_ecef_matrix(*place[:2]).numpy().T @ v_l

    def satellite(n: int, t: float) -> np.ndarray:
        one = KeplerEphemeris(*(x[n] for x in orbits))
        at = kepler_state(one, torch.tensor(t, dtype=torch.float64)).position.numpy()
        return about_z(wgs84.EARTH_RATE * t) @ at

    def distance(n: int, t: float) -> float:
        car = about_z(wgs84.EARTH_RATE * t) @ (start + velocity * (t - 700.0))

        def late(travel: float) -> float:
            away = float(np.linalg.norm(satellite(n, t - travel) - car))
            return away - SPEED_OF_LIGHT * travel

        return SPEED_OF_LIGHT * float(brentq(late, 0.05, 0.2, xtol=1e-17, rtol=1e-15))

    for n in (0, 7, 13, 22):
        assert found.distance[0, n] == pytest.approx(distance(n, 700.0), abs=1e-6)
        rate = (distance(n, 705.0) - distance(n, 695.0)) / 10.0
        bend = (distance(n, 710.0) - distance(n, 690.0)) / 20.0 - rate
        assert found.rate[0, n] == pytest.approx(rate - bend / 3.0, abs=2e-7)
    # The usual formula leaves millimetres per second out.
    east_north_up = frames.enu_from_ecef_matrix(*place[:2]).numpy()
    unit = np.stack(
        (
            np.cos(found.elevation) * np.sin(found.azimuth),
            np.cos(found.elevation) * np.cos(found.azimuth),
            np.sin(found.elevation),
        ),
        axis=-1,
    )[0]
    usual = (unit * (found.velocity[0] @ east_north_up.T - v_l)).sum(-1)
    up = found.elevation[0] > 0.0
    assert 1e-4 < np.abs(usual - found.rate[0])[up].max() < 0.02


@pytest.mark.parametrize(
    ("latitude", "fewest", "mean"), [(0, 7, 10), (30, 6, 9), (45, 6, 9), (65, 7, 10)]
)
def test_a_day_of_open_sky(latitude: int, fewest: int, mean: int) -> None:
    _, orbits = constellation("G", EPOCH)
    lat = np.full(DAY.size, math.radians(latitude))
    seen = signals(orbits, DAY, (lat, 0.0 * lat + 0.4, 0.0 * lat), np.zeros((DAY.size, 3)))
    up = seen.elevation > math.radians(7.5)
    assert up.sum(axis=1).min() >= fewest
    assert up.sum(axis=1).mean() == pytest.approx(mean, abs=0.8)
    for k in range(0, DAY.size, 12):
        e, a = seen.elevation[k, up[k]], seen.azimuth[k, up[k]]
        rows = (np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e), np.ones_like(e))
        dilution = np.linalg.inv(np.stack(rows) @ np.stack(rows).T)
        assert math.sqrt(dilution[0, 0] + dilution[1, 1]) < 2.0


def test_an_unknown_place_sees_nothing() -> None:
    _, orbits = constellation("G", EPOCH)
    one = np.array((np.nan,))
    seen = signals(orbits, np.zeros(1), (one, one, one), np.zeros((1, 3)))
    assert np.isnan(seen.elevation).all()
