"""One interval of strapdown navigation in a frame that is fixed to the Earth.

Shared by the local-level and the Earth-centred form, which differ only in where the frame stands.
In any such frame v̇ = C f + g − 2 ω_ie × v with g plumb gravity (gravitation and the Earth's
centrifugal force together, so it is not counted again): [Groves2013] §5.3. Half of
the Coriolis turn is made before the force acts and half after, which is of second order and
reversible in time.
"""

from torch import Tensor

from navlearn.mechanization.coning import cross


def turned_back(vector: Tensor, angle: Tensor) -> Tensor:
    """Return a vector as seen from a frame that has turned by a small angle.

    exp(−[angle×]) to second order: third powers of what a frame turns in an interval are far below
    rounding.

    Args:
        vector: Any vector, shape (..., 3).
        angle: Rotation vector of the frame, rad, shape (..., 3).

    Returns:
        The vector in the turned frame, shape (..., 3).
    """
    once = cross(angle, vector)
    return vector - once + 0.5 * cross(angle, once)


def moved_in_earth_fixed_frame(
    v: Tensor,
    C: Tensor,
    rotation: Tensor,
    velocity: Tensor,
    gravity: Tensor,
    turn_of_earth: Tensor,
    dt: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the velocity after one interval and the way moved in it.

    Args:
        v: Velocity against the Earth at the start, m/s, shape (..., 3).
        C: Rotation from body to the frame at the start, shape (..., 3, 3).
        rotation: Rotation vector of the body against inertial space, rad, shape (..., 3).
        velocity: Velocity increment in the body at the start, m/s, shape (..., 3).
        gravity: Plumb gravity in the middle of the interval, m/s², shape (..., 3).
        turn_of_earth: ω_ie dt, rad, shape (..., 3).
        dt: Length of the interval, s, shape (..., 1).

    Returns:
        Velocity (m/s) and way (m), shape (..., 3) each.
    """
    half = 0.5 * turn_of_earth
    added = (C @ velocity.unsqueeze(-1)).squeeze(-1)
    # a force that turns against the Earth leads less or more far than the trapezoid of velocity
    bent = (C @ cross(rotation, velocity).unsqueeze(-1)).squeeze(-1) - cross(turn_of_earth, added)
    pushed = turned_back(v, turn_of_earth) + turned_back(added, half) + gravity * dt
    after = turned_back(pushed, turn_of_earth)
    return after, dt * (0.5 * (v + after) - turned_back(bent, half) / 12.0)


def unit(quaternion: Tensor) -> Tensor:
    """Return a quaternion that has drifted a little from unit length, brought back to it.

    One Newton step for 1/√: exact to the square of the drift.

    Args:
        quaternion: Nearly unit quaternion, shape (..., 4).

    Returns:
        Unit quaternion, shape (..., 4).
    """
    return quaternion * (1.5 - 0.5 * (quaternion * quaternion).sum(-1, keepdim=True))
