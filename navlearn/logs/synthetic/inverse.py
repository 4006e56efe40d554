"""Inverse mechanization: what error-free sensors read on a given motion.

Attitude and velocity come from :class:`~navlearn.logs.synthetic.motion.Motion` in closed form,
position from integrating the velocity over the ellipsoid on a grid of at least 200 Hz. The
angular rate is the full one of strapdown navigation,
``omega_ib_b = omega_lb_b + C_bl (omega_ie + omega_el)``, and so is the specific force,
``f_b = C_bl (dv/dt + (2 omega_ie + omega_el) × v + γ up)``: [Groves2013] Eq. (5.18), (5.53).

Against the RISS azimuth equation the full z gyro has two more terms: the pitch rate in a
rolled car, and the horizontal Earth and transport rate in a tilted one. RISS from these
sensors therefore keeps a small error of its own, as on a real car.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from navlearn import attitude, earth
from navlearn.logs.synthetic.draws import Array
from navlearn.logs.synthetic.motion import Kinematics, Motion

GRID_RATE_HZ = 200.0
"""Lowest rate of the integration grid."""

_PASSES = 4


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Where the car is, at given times; N times.

    Attributes:
        t: Times, s, shape (N,).
        lat: Geodetic latitude, rad, shape (N,).
        lon: Longitude, rad, shape (N,).
        height: Height above the ellipsoid, m, shape (N,).
        v_l: Velocity, east, north, up, m/s, shape (N, 3).
        kinematics: Speed and attitude with their rates.
    """

    t: Array
    lat: Array
    lon: Array
    height: Array
    v_l: Array
    kinematics: Kinematics

    def pick(self, stride: int) -> "Truth":
        """Return every stride-th time, the first included."""
        return Truth(
            t=self.t[::stride],
            lat=self.lat[::stride],
            lon=self.lon[::stride],
            height=self.height[::stride],
            v_l=self.v_l[::stride],
            kinematics=Kinematics(*(channel[::stride] for channel in self.kinematics)),
        )


def velocity(k: Kinematics) -> tuple[Array, Array]:
    """Return velocity and its rate of change in east, north, up.

    v_l = speed · (sin A cos p, cos A cos p, sin p).

    Args:
        k: Kinematics, shape (N,).

    Returns:
        Velocity (m/s) and its derivative (m/s²), shape (N, 3) each.
    """
    sa, ca = np.sin(k.azimuth), np.cos(k.azimuth)
    sp, cp = np.sin(k.pitch), np.cos(k.pitch)
    forward = np.stack((sa * cp, ca * cp, sp), axis=-1)
    by_azimuth = np.stack((ca * cp, -sa * cp, np.zeros_like(sp)), axis=-1)
    by_pitch = np.stack((-sa * sp, -ca * sp, cp), axis=-1)
    turning = by_azimuth * k.azimuth_rate[:, None] + by_pitch * k.pitch_rate[:, None]
    return (
        forward * k.speed[:, None],
        forward * k.acceleration[:, None] + turning * k.speed[:, None],
    )


def body_rate(k: Kinematics) -> Array:
    """Return omega_lb_b from the angles and their rates.

    The azimuth turns about up (clockwise, hence the minus), the pitch about the x axis before
    the roll, the roll about y; [Noureldin2013] §2.3 in these axes.

    Args:
        k: Kinematics, shape (N,).

    Returns:
        Angular rate, rad/s, right, forward, up, shape (N, 3).
    """
    sp, cp, sr, cr = np.sin(k.pitch), np.cos(k.pitch), np.sin(k.roll), np.cos(k.roll)
    x = k.pitch_rate * cr + k.azimuth_rate * cp * sr
    y = k.roll_rate - k.azimuth_rate * sp
    z = k.pitch_rate * sr - k.azimuth_rate * cp * cr
    return np.stack((x, y, z), axis=-1)


def cumulative(f: Array, f_dot: Array, dt: float) -> Array:
    """Return the running integral by the trapezoid with end correction, of fourth order.

    Args:
        f: Integrand on the grid, shape (N,).
        f_dot: Its derivative, shape (N,).
        dt: Grid interval, s.

    Returns:
        Integral from the first grid point, shape (N,).
    """
    step = 0.5 * dt * (f[1:] + f[:-1]) + dt * dt / 12.0 * (f_dot[:-1] - f_dot[1:])
    return np.concatenate(([0.0], np.cumsum(step)))


def _radii(lat: Array) -> tuple[Array, Array]:
    tensor = torch.from_numpy(lat)
    return earth.meridian_radius(tensor).numpy(), earth.prime_vertical_radius(tensor).numpy()


def integrate(motion: Motion, origin: tuple[float, float, float], t: Array) -> Truth:
    """Return the truth on a uniform time grid that starts at zero.

    Latitude stands on both sides of its own rate: a few fixed-point passes settle it.

    Args:
        motion: The drive.
        origin: Latitude (rad), longitude (rad) and height (m) at t = 0.
        t: Uniform grid, s, shape (N,).
    """
    k = motion.at(t)
    v, v_dot = velocity(k)
    dt = float(t[1] - t[0])
    height = origin[2] + cumulative(v[:, 2], v_dot[:, 2], dt)
    lat = np.full_like(t, origin[0])
    for _ in range(_PASSES):
        scale = 1.0 / (_radii(lat)[0] + height)
        # The change of the radii adds nothing to the end correction: it telescopes to 1e-15 rad.
        lat = origin[0] + cumulative(v[:, 1] * scale, v_dot[:, 1] * scale, dt)
    scale = 1.0 / ((_radii(lat)[1] + height) * np.cos(lat))
    lon = origin[1] + cumulative(v[:, 0] * scale, v_dot[:, 0] * scale, dt)
    return Truth(t=t, lat=lat, lon=lon, height=height, v_l=v, kinematics=k)


def ideal_inertial(truth: Truth) -> tuple[Array, Array]:
    """Return omega_ib_b (rad/s) and f_b (m/s²) at the truth's times, shape (N, 3) each."""
    k = truth.kinematics
    lat, height, v = (torch.from_numpy(a) for a in (truth.lat, truth.height, truth.v_l))
    angles = (torch.from_numpy(a) for a in (k.azimuth, k.pitch, k.roll))
    c_lb = attitude.matrix_from_angles(*angles)
    omega_ie = earth.earth_rate_enu(lat)
    omega_el = earth.transport_rate_enu(lat, height, v[:, 0], v[:, 1])
    coriolis = torch.linalg.cross(2.0 * omega_ie + omega_el, v)
    force_l = torch.from_numpy(velocity(k)[1]) + coriolis
    force_l[:, 2] += earth.normal_gravity(lat, height)
    turned = torch.einsum("nij,nik->njk", c_lb, torch.stack((omega_ie + omega_el, force_l), -1))
    return body_rate(k) + turned[..., 0].numpy(), turned[..., 1].numpy()


def interval_means(values: Array, stride: int) -> Array:
    """Return means over intervals of a whole, even number of grid steps, by Simpson's rule.

    Args:
        values: Samples on the grid, shape (n · stride + 1, m).
        stride: Grid steps per interval, even.

    Returns:
        Means, shape (n, m).
    """
    total = values[0:-1:stride] + values[stride::stride]
    for k in range(1, stride):
        total = total + (4.0 if k % 2 else 2.0) * values[k::stride]
    return total / (3.0 * stride)


def grid_stride(imu_rate_hz: float) -> int:
    """Return how many grid steps an IMU interval is cut into: even, at least 200 Hz."""
    return 2 * int(np.ceil(GRID_RATE_HZ / (2.0 * imu_rate_hz)))


def truth_at(grid: Truth, motion: Motion, t: Array) -> Truth:
    """Return the truth at any times inside the drive.

    Attitude and velocity are evaluated, positions interpolated between grid points by their
    rates (cubic Hermite).

    Args:
        grid: Truth on its uniform grid.
        motion: The drive.
        t: Times, s, shape (N,).
    """
    k = motion.at(t)
    dt = float(grid.t[1] - grid.t[0])
    left = np.clip((t / dt).astype(np.int64), 0, grid.t.size - 2)
    fraction = t / dt - left
    r_m, r_n = _radii(grid.lat)
    rates = (
        grid.v_l[:, 1] / (r_m + grid.height),
        grid.v_l[:, 0] / ((r_n + grid.height) * np.cos(grid.lat)),
        grid.v_l[:, 2],
    )
    position = [
        _hermite(values, rate * dt, left, fraction)
        for values, rate in zip((grid.lat, grid.lon, grid.height), rates, strict=True)
    ]
    return Truth(
        t=t,
        lat=position[0],
        lon=position[1],
        height=position[2],
        v_l=velocity(k)[0],
        kinematics=k,
    )


def _hermite(values: Array, slopes: Array, left: NDArray[np.int64], x: Array) -> Array:
    a, b = values[left], values[left + 1]
    p, q = slopes[left], slopes[left + 1]
    d = b - a
    return a + x * (p + x * (3.0 * d - 2.0 * p - q + x * (p + q - 2.0 * d)))
