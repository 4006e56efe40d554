"""Whether yaw rate and odometer agree with the track: sign, unit, axis, scale, bias."""

from typing import Literal

import numpy as np

from navlearn.logs.drive_log import DriveLog
from navlearn.logs.quality.calibration import (
    reading_at_rest,
    speed_ratio,
    vertical_earth_rate,
)
from navlearn.logs.quality.comparisons import speed_comparison, turn_comparison
from navlearn.logs.quality.delay_fit import fit_delay
from navlearn.logs.quality.findings import Part, Severity
from navlearn.logs.quality.latency import (
    LIMIT,
    Disagreement,
    Estimate,
    Latency,
    compare,
)
from navlearn.logs.quality.signals import standstill, track_of

_DEG_PER_H = float(np.degrees(1.0)) * 3600.0


def check_turns(log: DriveLog) -> Part:
    """Compare the yaw rate with the turns of fixes and reference: sign, unit, axis, bias."""
    part = Part()
    still = standstill(log)
    part.figures["stationary_share"] = float(np.mean(still)) if len(still) else 0.0
    part.figures["earth_rate_up_deg_per_h"] = vertical_earth_rate(log) * _DEG_PER_H
    rest = reading_at_rest(log)
    if rest is None:
        part.not_observable["gyro_bias_at_rest_deg_per_h"] = "under 15 s of standstill"
    else:
        _note(part, "gyro_bias_at_rest", rest, "_deg_per_h")
    by_fixes, by_reference = compare(log, "fixes", "imu"), compare(log, "reference", "imu")
    best = by_fixes if isinstance(by_reference, str) else by_reference
    _note_bias(part, rest, best, trusted=best is by_reference)
    if isinstance(best, str):
        part.not_observable["gyro_scale"] = best
    else:
        scale = Estimate(1.0 / best.scale, best.scale_std / best.scale**2)
        _note(part, "gyro_scale", scale)
        part.figures["yaw_rate_correlation"] = best.correlation
        _judge_gyro_scale(part, scale)
    _check_axes(part, log, gyro_z=None if isinstance(best, str) else best)
    if not part.findings and isinstance(by_fixes, Disagreement):
        _judge_strange_turns(part, log, by_fixes)
    return part


def _judge_strange_turns(part: Part, log: DriveLog, reason: str) -> None:
    laid = turn_comparison(log, "fixes")
    if isinstance(laid, str) or len(laid.t) < 60 or not track_of(log.fixes).measured:
        return
    turned = laid.observed * laid.weight
    size = float(np.sqrt(np.mean(turned**2) / np.mean(laid.weight**2)))
    if size > 0.04:
        part.add(
            "error",
            "yaw rate beside the turns",
            "imu gyro_z, fixes",
            f"the fixes turn by {np.degrees(size):.1f}° a step (RMS), gyro_z otherwise: {reason}",
            "a yaw rate that follows the track",
            "map the right column to gyro_z, and put both tables on one clock",
        )


def _note(part: Part, name: str, found: Estimate, suffix: str = "") -> None:
    unit = _DEG_PER_H if suffix == "_deg_per_h" else 1.0
    part.note(name, found.value * unit, found.std * unit, suffix)


def _note_bias(part: Part, rest: Estimate | None, best: Latency | str, *, trusted: bool) -> None:
    drive = (
        None
        if isinstance(best, str)
        else Estimate(-best.offset / best.scale, best.offset_std / abs(best.scale))
    )
    if drive is not None:
        _note(part, "gyro_bias_in_motion", drive, "_deg_per_h")
    # A reference sees the bias through the whole drive; fixes must beat the standstills.
    better = drive is not None and (trusted or rest is None or drive.std < rest.std)
    chosen = drive if better else rest
    if chosen is None:
        part.not_observable["gyro_bias_deg_per_h"] = "no standstill, and no turns to compare with"
        return
    _note(part, "gyro_bias", chosen, "_deg_per_h")
    part.figures["gyro_bias_less_earth_rate_deg_per_h"] = (
        chosen.value * _DEG_PER_H - part.figures["earth_rate_up_deg_per_h"]
    )


def _judge_gyro_scale(part: Part, scale: Estimate) -> None:
    value, expected = scale.value, "a left turn positive, rad/s, scale 1"
    where = "imu gyro_z"
    found = f"gyro_z reports {value:.4g} of the turns of the track"
    size = abs(value)
    if value < 0.0:
        part.add(
            "error",
            "yaw rate sign",
            where,
            found,
            expected,
            "turn the axis in the descriptor (z down gives a right turn positive)",
        )
    if 30.0 < size < 100.0:
        part.add(
            "error", "yaw rate unit", where, found, expected, "it is in deg/s: divide by 57.2958"
        )
    elif 0.01 < size < 0.03:
        part.add(
            "error",
            "yaw rate unit",
            where,
            found,
            expected,
            "it was turned from degrees twice: multiply by 57.2958",
        )
    elif abs(size - 1.0) > max(0.05, 4.0 * scale.std):
        severity: Severity = "error" if abs(size - 1.0) > max(0.3, 4.0 * scale.std) else "warning"
        part.add(
            severity,
            "yaw rate scale",
            where,
            found,
            expected,
            "calibrate the scale, or look whether another axis points up",
        )


def _check_axes(part: Part, log: DriveLog, *, gyro_z: Latency | None) -> None:
    lacking = isinstance(turn_comparison(log, "fixes"), str)
    table: Literal["fixes", "reference"] = "reference" if lacking else "fixes"
    own = 0.0 if gyro_z is None else gyro_z.correlation
    for axis in ("gyro_x", "gyro_y"):
        laid = turn_comparison(log, table, gyro=axis)
        if isinstance(laid, str) or len(laid.t) < 20:
            continue
        fit = fit_delay(laid.t, laid.observed, laid.design, weight=laid.weight, limit=LIMIT)
        if fit is None or fit.correlation < max(0.6, own + 0.1):
            continue
        part.add(
            "error",
            "swapped gyro axes",
            f"imu {axis}",
            f"{axis} follows the turns of the track (correlation {fit.correlation:.2f}, "
            f"scale {1.0 / fit.coefficients[0]:+.3g}), gyro_z less (correlation {own:.2f})",
            "gyro_z up, following the turns",
            f"map {axis} to z in the descriptor",
        )


def check_speed(log: DriveLog) -> Part:
    """Compare the odometer with the speed of the fixes, or of the reference without them."""
    part = Part()
    scale = speed_ratio(log, "fixes") or speed_ratio(log, "reference")
    found = compare(log, "odometer", "fixes")
    if isinstance(found, Disagreement) and _judge_strange_speed(part, log, found):
        return part
    if scale is None:
        part.not_observable["odometer_scale"] = "no odometer, or no track in motion beside it"
        return part
    _note(part, "odometer_scale", scale)
    _judge_odometer_scale(part, scale.value)
    return part


def _judge_strange_speed(part: Part, log: DriveLog, reason: str) -> bool:
    laid = speed_comparison(log, "fixes")
    if isinstance(laid, str) or len(laid.t) < 60 or not track_of(log.fixes).measured:
        return False
    other = laid.design(np.zeros(len(laid.t)))[:, 0]
    change = min(float(np.std(laid.observed)), float(np.nanstd(other)))
    if change < 2.0:
        return False
    part.not_observable["odometer_scale"] = reason
    part.add(
        "error",
        "odometer beside the track",
        "odometer speed, fixes",
        f"both vary by {change:.1f} m/s or more (RMS), each by itself: {reason}",
        "an odometer that follows the track",
        "map the right column to speed, and put both tables on one clock",
    )
    return True


def _judge_odometer_scale(part: Part, value: float) -> None:
    known = {
        3.6: "it is in km/h: divide by 3.6",
        2.2369: "it is in mph: divide by 2.2369",
        1.9438: "it is in knots: divide by 1.9438",
        1 / 3.6: "it was turned from km/h twice: multiply by 3.6",
        0.44704: "it was turned from mph twice: divide by 0.44704",
    }
    remedy = next((text for unit, text in known.items() if abs(value / unit - 1.0) < 0.08), None)
    found = f"the odometer reports {value:.4f} of the speed of the track"
    if remedy is not None:
        part.add("error", "odometer unit", "odometer speed", found, "m/s, scale 1", remedy)
    elif abs(value - 1.0) > 0.03:
        part.add(
            "error" if abs(value - 1.0) > 0.3 else "warning",
            "odometer scale",
            "odometer speed",
            found,
            "a scale within 3 % of one",
            "divide by the scale, or let the filter estimate it from a wide start",
        )
