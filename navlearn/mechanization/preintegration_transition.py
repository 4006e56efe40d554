"""What becomes of errors over a preintegrated window: transition matrix and noise.

The derivative of :func:`navlearn.mechanization.preintegration_predict.predict` in the errors of
:class:`navlearn.filters.ins_belief.InsBelief`, composed of the window's increments and their
derivatives: the φ-angle model ([Groves2013] §14.2.4) solved over the window instead of sample by
sample. What changes a metre's worth of error by less than 1e-5 over a second is left out.
"""

import torch
from torch import Tensor

from navlearn import earth
from navlearn.attitude import matrix_from_quaternion
from navlearn.mechanization.preintegration_predict import corrected
from navlearn.mechanization.preintegration_sums import skew
from navlearn.mechanization.preintegration_window import Preintegrated
from navlearn.states import InsState


def block_transition(
    state: InsState,
    pre: Preintegrated,
    sensor_walk: Tensor,
    change: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Return Φ and Q of the error state over a window.

    Errors of the sensor parameters are constant but for their random walks. Parameters beyond
    those that were preintegrated (an odometer's scale) touch nothing else.

    Args:
        state: State at the start of the window, shape (...).
        pre: The window's increments, shape (...).
        sensor_walk: Random walk of each sensor parameter, its unit per √s, shape (m,) or
            (..., m).
        change: Sensor parameters minus those taken off in preintegration, shape (..., m); None
            means no change.

    Returns:
        Transition and covariance of the accumulated noise, shape (..., 9 + m, 9 + m) each.
    """
    m = sensor_walk.shape[-1]
    known = min(m, pre.by_sensor.shape[-1])
    inc = corrected(pre, change)
    core, frame = _navigation(state, inc)
    by_sensor = frame @ pre.by_sensor[..., :known]
    eye = torch.diag_embed(inc.duration.unsqueeze(-1) * 0.0 + torch.ones_like(sensor_walk))
    top = torch.cat((core, torch.nn.functional.pad(by_sensor, (0, m - known))), dim=-1)
    transition = torch.cat((top, torch.nn.functional.pad(eye, (9, 0))), dim=-2)
    white = frame @ pre.covariance @ frame.transpose(-1, -2)
    noise = torch.nn.functional.pad(white, (0, m, 0, m))
    noise = noise + _walked(by_sensor, sensor_walk, inc.duration)
    return transition, 0.5 * (noise + noise.transpose(-1, -2))


def _navigation(state: InsState, inc: Preintegrated) -> tuple[Tensor, Tensor]:
    """Return Φ of position, velocity and attitude, and what turns errors of increments into theirs.

    Both (..., 9, 9). First everything in axes fixed to the Earth at the start, then the axes of
    the end, which an error of the way has turned, too.
    """
    T = inc.duration.unsqueeze(-1).unsqueeze(-1)
    lat, height = state.lat, state.height
    C = matrix_from_quaternion(state.q_lb)
    r_m, r_n = earth.meridian_radius(lat) + height, earth.prime_vertical_radius(lat) + height
    gamma, omega = earth.normal_gravity(lat, height), earth.earth_rate_enu(lat)
    zero, tan = torch.zeros_like(lat), torch.tan(lat)
    eye = torch.eye(3, dtype=lat.dtype, device=lat.device).expand(C.shape)
    none = torch.zeros_like(C)
    turning, still = skew(omega), eye - T * skew(omega)
    # columns: position, velocity; then what an error of the increments does
    fall = torch.diag_embed(torch.stack((zero, zero, 2.0 * gamma / r_m), dim=-1))
    slope = torch.diag_embed(torch.stack((-gamma / r_n, -gamma / r_m, 2.0 * gamma / r_m), dim=-1))
    way_by_speed = T * still
    speed_by_speed = eye - 2.0 * T * turning + 0.5 * T * T * slope
    way = torch.cat((none, way_by_speed, still @ C, none, none), dim=-1)
    speed = torch.cat((T * fall, speed_by_speed, -turning @ C, still @ C, none), dim=-1)
    # what an error of the way turns the level by
    rate = state.v_l + (C @ inc.velocity.unsqueeze(-1)).squeeze(-1)
    rate = rate - torch.nn.functional.pad((gamma * inc.duration).unsqueeze(-1), (2, 0))
    tilt = torch.stack((zero, -1.0 / r_m, zero, 1.0 / r_n, zero, zero, tan / r_n, zero, zero), -1)
    tilt = tilt.reshape(C.shape)
    turned = tilt @ way
    mean = 0.5 * (state.v_l + rate)
    place = skew((tilt @ mean.unsqueeze(-1)).squeeze(-1)) * T
    speed = speed - place @ speed + skew(rate) @ turned
    north = torch.stack((zero, -omega[..., 2], omega[..., 1]), dim=-1) / r_m.unsqueeze(-1)
    sky = torch.nn.functional.pad((T.squeeze(-1) * north).unsqueeze(-1), (1, 1))
    sky = torch.nn.functional.pad(sky, (0, 12))
    attitude = torch.cat((none, none, none, none, (still - place) @ C), dim=-1) - turned - sky
    position = torch.nn.functional.pad(eye, (0, 12)) + way
    rows = torch.cat((position, speed, attitude), dim=-2)
    frame = rows[..., 6:]
    # φ turns the increments: [φ×] C u = −[C u×] φ = −C [u×] Cᵀ φ
    tipped = torch.cat((-skew(inc.position), -skew(inc.velocity), eye), dim=-2)
    return torch.cat((rows[..., :6], frame @ tipped @ C.transpose(-1, -2)), dim=-1), frame


def _walked(by_sensor: Tensor, walk: Tensor, duration: Tensor) -> Tensor:
    """Return Q of the sensors' random walks.

    What a parameter does grows over the window as a power of time: a rate turns by t, its turning
    changes velocity by t², position by t³; a force changes velocity by t, position by t².
    """
    m, known = walk.shape[-1], by_sensor.shape[-1]
    group = [1.0 if k // 3 % 2 == 0 else 0.0 for k in range(known)]
    gyro = torch.tensor(group, dtype=walk.dtype, device=walk.device)
    row = torch.tensor([2.0] * 3 + [1.0] * 3 + [0.0] * 3, dtype=walk.dtype, device=walk.device)
    T = duration.unsqueeze(-1).unsqueeze(-1)
    density = (walk * walk).unsqueeze(-2) * T
    known_density = density[..., :known]
    cross = by_sensor * known_density / (row.unsqueeze(-1) + gyro + 1.0)
    both = row.unsqueeze(-1) + row + 1.0
    total = torch.zeros_like(T) * both
    for kind in (0.0, 1.0):
        chosen = torch.where(gyro == kind, by_sensor, torch.zeros_like(by_sensor))
        spread = (chosen * known_density) @ chosen.transpose(-1, -2)
        total = total + spread / (both + 2.0 * kind)
    cross = torch.nn.functional.pad(cross, (0, m - known))
    own = torch.diag_embed(density.squeeze(-2))
    top = torch.cat((total, cross), dim=-1)
    return torch.cat((top, torch.cat((cross.transpose(-1, -2), own), dim=-1)), dim=-2)
