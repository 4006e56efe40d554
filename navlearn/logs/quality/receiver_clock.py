"""What the ranges tell of the receiver's clock: its drift, and where it was set."""

import numpy as np

from navlearn.logs.quality.findings import Part
from navlearn.logs.quality.signals import median_interval
from navlearn.logs.single_point_fixes import ReceptionSolutions

_JUMP = 3000.0
"""Change beyond its drift that makes a clock's step a jump, m: 10 µs."""

_MILLISECOND = 299792.458


def check_receiver_clock(part: Part, found: ReceptionSolutions) -> None:
    """Note the drift of the receiver clock and report its jumps.

    Args:
        part: What the checks found, added to.
        found: Solutions of all receptions.
    """
    first = np.isfinite(found.points.clock_std[:, 0].numpy())
    kept = found.points.ok.numpy() & first
    t, clock = found.series.t.numpy()[kept], found.points.clock[kept, 0].numpy()
    if len(t) < 3:
        part.not_observable["receiver_clock_drift_m_per_s"] = "under three receptions solved"
        return
    dt, step = np.diff(t), np.diff(clock)
    drift = float(np.median(step / dt))
    part.figures["receiver_clock_drift_m_per_s"] = drift
    near = dt < 2.5 * median_interval(t)
    beyond = np.where(near, step - drift * dt, 0.0)
    jumps = np.flatnonzero(np.abs(beyond) > _JUMP)
    part.figures["receiver_clock_jumps"] = float(len(jumps))
    if len(jumps) == 0:
        return
    size = float(np.median(np.abs(beyond[jumps]))) / _MILLISECOND
    many = len(jumps) > 0.1 * np.count_nonzero(near)
    part.add(
        "warning" if many else "info",
        "clock jumps",
        f"ranges at {t[1:][jumps[0]]:.2f} s",
        f"{len(jumps)} jumps of the receiver clock beyond its drift of {drift:.2f} m/s, of "
        f"{size:.4g} ms (median)",
        "a clock that drifts, set by whole milliseconds now and then",
        "check whether ranges and time stamps are of one clock"
        if many
        else "nothing: a tight filter opens its clock there",
    )
