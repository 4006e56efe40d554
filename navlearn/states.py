"""What travels between rooms: named tuples of tensors.

Every field is a float64 tensor unless said otherwise. ``...`` is any batch shape; T counts
samples, M fixes. Sensor samples describe the *interval* that ends at their time: a rate is the
mean over the interval, so a step needs no neighbour.
"""

from typing import NamedTuple

from torch import Tensor


class NavState(NamedTuple):
    """Position and attitude of the car, shape (...) each.

    Attributes:
        lat: Geodetic latitude, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
        azimuth: Azimuth of the forward axis, rad, clockwise from north, not wrapped.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    azimuth: Tensor


class RissSample(NamedTuple):
    """What one gyro, the odometer and tilt told over intervals; shape (...) or (..., T) each.

    Attributes:
        dt: Length of the interval, s; zero marks padding and moves nothing.
        yaw_rate: Mean z gyro, rad/s, left turn positive.
        speed: Mean odometer speed along the forward axis, m/s.
        pitch: Mean pitch, rad, nose up positive; zero in 2D.
        roll: Mean roll, rad, right side down positive; zero in 2D.
        f_x: Mean transversal specific force, m/s² (zero where the log has none).
        f_y: Mean forward specific force, m/s² (zero where the log has none).
        stationary: 1.0 where the car stands still through the interval, else 0.0.
    """

    dt: Tensor
    yaw_rate: Tensor
    speed: Tensor
    pitch: Tensor
    roll: Tensor
    f_x: Tensor
    f_y: Tensor
    stationary: Tensor


class InsState(NamedTuple):
    """Position, velocity and attitude of a car with a full IMU.

    Shape (...) for a state, (..., T) for a solution at the end of every interval; vectors have
    their axis last.

    Attributes:
        lat: Geodetic latitude, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
        v_l: Velocity against the Earth, east, north, up, m/s, shape (..., 3).
        q_lb: Scalar-first unit quaternion that turns body into local level, shape (..., 4).
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    v_l: Tensor
    q_lb: Tensor


class ImuSample(NamedTuple):
    """What a full IMU and an odometer told over intervals; shape (...) or (..., T) each.

    Attributes:
        dt: Length of the interval, s; zero marks padding and moves nothing.
        omega_ib_b: Mean angular rate of the body against inertial space, rad/s, shape (..., 3).
        f_b: Mean specific force, m/s², shape (..., 3).
        speed: Mean odometer speed along the forward axis, m/s.
        has_speed: 1.0 where the odometer told a speed, else 0.0.
        stationary: 1.0 where the car stands still through the interval, else 0.0.
    """

    dt: Tensor
    omega_ib_b: Tensor
    f_b: Tensor
    speed: Tensor
    has_speed: Tensor
    stationary: Tensor


class GnssFix(NamedTuple):
    """GNSS solutions, shape (...) or (..., M) each; what is not valid may hold any finite value.

    Attributes:
        lat: Latitude of the antenna, rad.
        lon: Longitude of the antenna, rad.
        height: Height of the antenna, m.
        v_e: Velocity to the east, m/s.
        v_n: Velocity to the north, m/s.
        v_u: Velocity up, m/s.
        std_e: Standard deviation of position to the east, m.
        std_n: Standard deviation of position to the north, m.
        std_u: Standard deviation of height, m.
        std_v: Standard deviation of each velocity component, m/s.
        has_position: 1.0 where the position may be used, else 0.0.
        has_velocity: 1.0 where the velocity may be used, else 0.0.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    v_e: Tensor
    v_n: Tensor
    v_u: Tensor
    std_e: Tensor
    std_n: Tensor
    std_u: Tensor
    std_v: Tensor
    has_position: Tensor
    has_velocity: Tensor


class SatelliteRanges(NamedTuple):
    """Raw ranges of M receptions to S satellites, shape (..., M, S) each unless said otherwise.

    A satellite keeps its place along S through a drive. What is not measured may hold any finite
    value. Ranges are free of what the broadcast tells: satellite clock, ionosphere, troposphere.

    Attributes:
        satellite: Satellite when it sent, Earth-fixed axes of the moment of reception, m, shape
            (..., M, S, 3).
        satellite_velocity: Its velocity against the Earth in the same axes, m/s, shape
            (..., M, S, 3).
        pseudorange: Geometric range plus receiver clock plus error, m.
        range_rate: Its rate by Doppler, m/s, positive when moving apart.
        elevation: Elevation of the satellite over the car's horizon, rad.
        cn0: Carrier-to-noise density, dB-Hz; 45 where the log has none.
        std_range: Deviation that the receiver tells of its pseudorange, m; 0 where it tells none.
        std_rate: The same of the range rate, m/s.
        system: Whose time the satellite keeps: 0 for the first system of the log, then 1, 2, …,
            int64, shape (..., S).
        has_range: 1.0 where the pseudorange may be used, else 0.0.
        has_rate: 1.0 where the range rate may be used, else 0.0.
    """

    satellite: Tensor
    satellite_velocity: Tensor
    pseudorange: Tensor
    range_rate: Tensor
    elevation: Tensor
    cn0: Tensor
    std_range: Tensor
    std_rate: Tensor
    system: Tensor
    has_range: Tensor
    has_rate: Tensor


class FixTiming(NamedTuple):
    """Where fixes, or receptions of ranges, fall among the samples, shape (..., M) each.

    Attributes:
        index: The fix is used at the end of interval ``index``, int64, not decreasing; −1 marks
            padding that stands for no fix.
        delay: End of that interval minus the time at which the fix was valid, s; what the car
            moved meanwhile is taken off the prediction.
    """

    index: Tensor  # type: ignore[assignment]  # hides tuple.index, which no one calls
    delay: Tensor


class Trajectory(NamedTuple):
    """A navigation solution at the end of every interval, shape (..., T) each.

    Attributes:
        lat: Geodetic latitude, rad.
        lon: Longitude, rad.
        height: Height above the ellipsoid, m.
        azimuth: Azimuth, rad, not wrapped.
        v_e: Velocity to the east, m/s, mean over the interval.
        v_n: Velocity to the north, m/s, mean over the interval.
        v_u: Velocity up, m/s, mean over the interval.
    """

    lat: Tensor
    lon: Tensor
    height: Tensor
    azimuth: Tensor
    v_e: Tensor
    v_n: Tensor
    v_u: Tensor
