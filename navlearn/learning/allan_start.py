"""Where a filter's noise starts before anything is tuned: the Allan variance of a standstill.

A standstill shows what a sensor does by itself. Scale factors, roads and receivers it does not
show: what is not told here stays as it is, and driving is noisier than standing.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from navlearn.errors import FitError
from navlearn.learning.tuned_values import TunedValues
from navlearn.logs.allan.standstill_noise import AxisNoise, StandstillNoise, standstill_noise
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.six_axes import ACCELEROMETERS, GYROS


def tuned_by_allan(
    log: DriveLog,
    *,
    sensors: Literal["riss", "imu"] = "riss",
    start: float | None = None,
    stop: float | None = None,
) -> TunedValues:
    """Return the options of a filter that a standstill tells.

    Args:
        log: A log with a standstill.
        sensors: Whose options: ``riss`` needs the z gyro, ``imu`` all six axes.
        start: First time of the standstill, s; without start and stop the longest one serves.
        stop: Its last time, s.

    Raises:
        LogError: The standstill is too short, or an axis has gaps or always reads the same.
        MissingExtraError: allantools is not installed.
    """
    axes = ("gyro_z",) if sensors == "riss" else (*GYROS, *ACCELEROMETERS)
    found = standstill_noise(log, start=start, stop=stop, axes=axes)
    return allan_values(found, sensors=sensors)


def allan_values(found: StandstillNoise, *, sensors: Literal["riss", "imu"]) -> TunedValues:
    """Return the options of a filter that the noise of a standstill tells.

    Args:
        found: Noise by axis.
        sensors: Whose options.

    Raises:
        FitError: Axes that it needs are not told.
    """
    needed = ("gyro_z",) if sensors == "riss" else (*GYROS, *ACCELEROMETERS)
    axes = [axis for name in needed if (axis := found.axis(name)) is not None]
    if len(axes) < len(needed):
        missing = [name for name in needed if found.axis(name) is None]
        why = "; ".join(found.left_out[name] for name in missing if name in found.left_out)
        raise FitError(f"{found.log}: the noise of {', '.join(missing)} is not told. {why}".strip())
    gyros = [axis for axis in axes if axis.is_gyro]
    accelerometers = [axis for axis in axes if not axis.is_gyro]
    noise = _noise_of(gyros, "gyro")
    noise["zero_yaw_rate" if sensors == "riss" else "zero_angular_rate"] = _root_mean_square(
        [axis.terms.least for axis in gyros]
    )
    if accelerometers:
        noise.update(_noise_of(accelerometers, "accel"))
    untold = [name for name in ("gyro_bias_walk",) if name not in noise]
    if accelerometers and "accel_bias_walk" not in noise:
        untold.append("accel_bias_walk")
    return TunedValues(
        filter={"noise": noise},
        figures={
            "stretch_s": found.stretch.length,
            **{axis.axis: _figures(axis) for axis in axes},
        },
        notes=(
            f"Allan variance of {found.log} from {found.stretch.start:.1f} to "
            f"{found.stretch.stop:.1f} s, standing; driving is noisier",
            *(f"{name}: the standstill is too short to show it; as before" for name in untold),
            *(
                f"{axis.axis}: no white noise is shown; what is between samples a second apart "
                "stands for it"
                for axis in axes
                if not axis.terms.white.shown
            ),
            *(f"{axis.axis}: {note}" for axis in axes for note in axis.notes),
        ),
    )


def _noise_of(axes: Sequence[AxisNoise], sensor: str) -> dict[str, float]:
    """Return random walk and bias walk of axes that share an option: their root mean squares."""
    noise = {f"{sensor}_random_walk": _root_mean_square([_random_walk(axis) for axis in axes])}
    walks = [axis.terms.walk.value for axis in axes if axis.terms.walk.shown]
    if walks:
        noise[f"{sensor}_bias_walk"] = _root_mean_square(walks)
    return noise


def _random_walk(axis: AxisNoise) -> float:
    """Return an axis's white noise, or what makes as much over a second where it is not shown."""
    white = axis.terms.white
    if white.shown:
        return white.value
    return float(np.interp(0.0, np.log(axis.curve.tau), axis.curve.deviation))


def _figures(axis: AxisNoise) -> dict[str, int | float]:
    told: dict[str, int | float] = {"least": axis.terms.least}
    for name in ("quantisation", "white", "instability", "walk"):
        term = getattr(axis.terms, name)
        if term.shown:
            told |= {name: term.value, f"{name}_low": term.low}
        told[f"{name}_high"] = term.high
    return told


def _root_mean_square(values: Sequence[float]) -> float:
    return float((sum(value * value for value in values) / len(values)) ** 0.5)
