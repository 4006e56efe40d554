"""Whether the accelerometer agrees with speed and turns: axes and signs."""

import numpy as np

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.comparisons import gain_comparison
from navlearn.logs.quality.delay_fit import fit_delay
from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.latency import LIMIT, compare
from navlearn.logs.quality.signals import Array, column, integral


def check_forces(log: DriveLog) -> Part:
    """Compare the accelerometer with the odometer's gain and with the turns."""
    part = Part()
    _check_sideways(part, log)
    laid = gain_comparison(log, "odometer")
    own = laid if isinstance(laid, str) else compare(log, "odometer", "imu")
    if isinstance(own, str):
        part.not_observable["accel_y_correlation"] = own
    else:
        part.figures["accel_y_correlation"] = own.correlation
        if own.scale < 0.0:
            part.add(
                "error",
                "forward force sign",
                "imu accel_y",
                f"the car speeds up where accel_y is negative (factor {own.scale:.2f})",
                "positive when the car speeds up",
                "turn the axis in the descriptor",
            )
    _check_exchange(part, log, 0.0 if isinstance(own, str) else own.correlation)
    return part


def _check_exchange(part: Part, log: DriveLog, own: float) -> None:
    laid = gain_comparison(log, "odometer", along="accel_x")
    if isinstance(laid, str) or len(laid.t) < 20:
        return
    fit = fit_delay(laid.t, laid.observed, laid.design, weight=laid.weight, limit=LIMIT)
    if fit is not None and fit.correlation > max(0.6, own + 0.2):
        part.add(
            "error",
            "swapped accelerometer axes",
            "imu accel_x, accel_y",
            f"accel_x follows the gain of speed (correlation {fit.correlation:.2f}), "
            f"accel_y less (correlation {own:.2f})",
            "y forward, following the gain of speed",
            "map the axes in the descriptor: x right, y forward, z up",
        )


def _check_sideways(part: Part, log: DriveLog) -> None:
    found = sideways_correlation(log)
    if isinstance(found, str):
        part.not_observable["accel_x_correlation"] = found
        return
    part.figures["accel_x_correlation"] = found
    if found < -0.5:
        part.add(
            "error",
            "sideways force sign",
            "imu accel_x",
            f"accel_x pulls into the turn (correlation {found:.2f} with what the turn needs)",
            "x to the right: negative in a left turn",
            "turn the axis in the descriptor",
        )


def sideways_correlation(log: DriveLog, *, window: float = 2.0) -> float | str:
    """Return how accel_x correlates with minus speed times yaw rate, or why it cannot be told.

    A car that turns left is pushed to the left: f_x = -v ω_z for x to the right.

    Args:
        log: The log, in order.
        window: Length of the means compared, s: long against latencies, short against turns.
    """
    if not np.any(np.isfinite(column(log.imu, "accel_x"))):
        return "the log has no accel_x"
    t, speed = column(log.odometer, "t"), column(log.odometer, "speed")
    known = np.isfinite(speed)
    if np.count_nonzero(known) < 3:
        return "the log has no odometer"
    t_i = column(log.imu, "t")
    edges = np.arange(t_i[0], t_i[-1], window)
    if len(edges) < 20:
        return "the log is too short"
    force, rate = (_means(t_i, integral(log, name), edges) for name in ("accel_x", "gyro_z"))
    pace = np.interp(0.5 * (edges[1:] + edges[:-1]), t[known], speed[known])
    turning = (pace > 3.0) & (np.abs(rate - np.median(rate)) * pace > 0.3)
    if np.count_nonzero(turning) < 10:
        return "too few turns at speed"
    a, b = force[turning], -(pace * (rate - np.median(rate)))[turning]
    if np.std(a) == 0.0 or np.std(b) == 0.0:
        return "nothing changes in the turns"
    return float(np.corrcoef(a, b)[0, 1])


def _means(t: Array, running: Array, edges: Array) -> Array:
    return np.asarray(np.diff(np.interp(edges, t, running)) / np.diff(edges), dtype=np.float64)
