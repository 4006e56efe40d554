"""Ranges of a simulated receiver: satellites, streets, errors and clock become a log's table."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray

from navlearn.gnss.ephemeris import KeplerEphemeris
from navlearn.gnss.gnss_time import WEEK
from navlearn.gnss.range_noise import CN0_OF_FIGURES
from navlearn.logs.range_truth import COLUMNS, RangeTruth
from navlearn.logs.synthetic.aiding import antenna
from navlearn.logs.synthetic.draws import Array, generator
from navlearn.logs.synthetic.inverse import Truth
from navlearn.logs.synthetic.range_errors import RangeErrors, carrier_to_noise, range_errors
from navlearn.logs.synthetic.receiver_clock import ReceiverClock, receiver_clock
from navlearn.logs.synthetic.reflections import reflections
from navlearn.logs.synthetic.satellite_options import SatelliteOptions
from navlearn.logs.synthetic.satellites import EPOCH, Signals, constellation, signals
from navlearn.logs.synthetic.street import hidden, roofs

CORRECTIONS: Final = ("satellite_clock", "ionosphere", "troposphere")
"""What simulated ranges are already free of; their satellites are in the axes of sending."""


@dataclass(frozen=True, kw_only=True)
class SimulatedRanges:
    """Ranges of one drive.

    Attributes:
        table: Columns of :data:`navlearn.logs.columns.RANGES` but clocks and delays, which
            are corrected already.
        truth: The errors and the clock.
        gps_time_origin: What t = 0 of the drive is, GPS seconds since 6 January 1980.
    """

    table: pd.DataFrame
    truth: RangeTruth
    gps_time_origin: float

    def without_errors(self) -> "SimulatedRanges":
        """Return the same satellites without error; the receiver's clock stays."""
        known = self.truth.table
        exact = self.table.assign(
            pseudorange=self.table["pseudorange"] - known["range_error"],
            range_rate=self.table["range_rate"] - known["rate_error"],
        )
        parts = [name for name in COLUMNS if name in (*RangeErrors._fields, "range_error")]
        none = dict.fromkeys((*parts, "rate_error"), 0.0)
        return replace(self, table=exact, truth=RangeTruth(table=known.assign(**none)))


class _Sky(NamedTuple):
    names: tuple[str, ...]
    signals: Signals
    cn0: Array
    errors: RangeErrors
    clock: ReceiverClock
    offset: Array
    received: NDArray[np.bool_]


def simulated_ranges(
    t: Array,
    truth: Truth,
    *,
    options: SatelliteOptions,
    lever_arm: tuple[float, float, float],
    seed: int,
) -> SimulatedRanges:
    """Return the ranges that a receiver on the car measures.

    Stamps are free of the receiver's clock: a receiver that has solved for it states its
    receptions in GPS time. A reception whose place is not known (NaN) takes in nothing.

    Args:
        t: Stamps at a uniform interval, s, shape (M,).
        truth: The car when each reception took place (stamp minus latency), M times.
        options: Satellites, streets and receiver.
        lever_arm: Antenna from the IMU, right, forward, up, m.
        seed: Seed of the simulation.
    """
    origin = gps_origin(options, seed)
    sky = _sky(t, truth, origin, options, lever_arm, seed)
    row, column = np.nonzero(sky.received)
    pick = (row, column)
    names = np.array(sky.names, dtype=object)[column]
    clock = sky.clock.offset[row] + sky.offset[column]
    true_range = sky.signals.distance[pick] + clock
    true_rate = sky.signals.rate[pick] + sky.clock.rate[row]
    error, rate_error = sky.errors.range()[pick], sky.errors.rate[pick]
    tracking = 10.0 ** ((CN0_OF_FIGURES - sky.cn0[pick]) / 20.0)
    columns = {
        "t": t[row],
        "satellite": names,
        "pseudorange": true_range + error,
        "range_rate": true_rate + rate_error,
        "cn0": sky.cn0[pick],
        "std_range": np.maximum(options.thermal * tracking, _LEAST_STD),
        "std_rate": np.maximum(options.rate_thermal * tracking, _LEAST_RATE_STD),
    }
    for i, axis in enumerate("xyz"):
        columns[f"sat_{axis}"] = sky.signals.position[pick][:, i]
    for i, axis in enumerate("xyz"):
        columns[f"sat_v{axis}"] = sky.signals.velocity[pick][:, i]
    known = {
        "t": t[row],
        "satellite": names,
        "range_error": error,
        "rate_error": rate_error,
        "clock": sky.clock.offset[row],
        "clock_rate": sky.clock.rate[row],
        "system_offset": sky.offset[column],
        "elevation": sky.signals.elevation[pick],
        "azimuth": sky.signals.azimuth[pick],
        **{name: getattr(sky.errors, name)[pick] for name in RangeErrors._fields[:-1]},
    }
    table = _text(pd.DataFrame(columns))
    return SimulatedRanges(
        table=table,
        truth=RangeTruth(table=_text(pd.DataFrame(known))[list(COLUMNS)]),
        gps_time_origin=origin,
    )


def gps_origin(options: SatelliteOptions, seed: int) -> float:
    """Return what t = 0 of a drive is, GPS seconds since 6 January 1980.

    Args:
        options: States it, or leaves it to be drawn.
        seed: Seed of the simulation.
    """
    if options.gps_time is not None:
        return options.gps_time
    return EPOCH + float(generator(seed, "ranges/time").integers(0, int(WEEK) - 86400))


_LEAST_STD = 0.01
_LEAST_RATE_STD = 0.002


def _sky(
    t: Array,
    truth: Truth,
    origin: float,
    options: SatelliteOptions,
    lever_arm: tuple[float, float, float],
    seed: int,
) -> _Sky:
    lat, lon, height, velocity = antenna(truth, lever_arm)
    names, orbits = _satellites(options.systems, origin)
    # Seconds of the week keep nanometres that seconds since 1980 round to half a millimetre.
    seen = signals(orbits, origin % WEEK + truth.t, (lat, lon, height), velocity)
    dt = float(t[1] - t[0]) if t.size > 1 else 1.0
    speed = np.nan_to_num(truth.kinematics.speed)
    way = np.cumsum(speed) * dt
    roof = roofs(way, options=options, seed=seed)
    heading = truth.kinematics.azimuth
    behind = hidden(roof, heading, seen.azimuth, seen.elevation)
    elevation = np.nan_to_num(seen.elevation)
    bounced = reflections(names, elevation, behind, dt, options=options, seed=seed)
    cn0 = carrier_to_noise(names, elevation, bounced.loss, dt, options=options, seed=seed)
    errors = range_errors(names, elevation, cn0, speed, bounced, dt, options=options, seed=seed)
    above = seen.elevation > np.radians(options.lowest_deg)
    received = above & ~bounced.lost & (cn0 >= options.cn0_threshold)
    return _Sky(
        names=names,
        signals=seen,
        cn0=cn0,
        errors=errors,
        clock=receiver_clock(t.size, dt, options=options, seed=seed),
        offset=_offsets(names, options, seed),
        received=np.asarray(received, dtype=np.bool_),
    )


def _satellites(
    systems: tuple[str, ...], gps_time: float
) -> tuple[tuple[str, ...], KeplerEphemeris]:
    found = [constellation(system, gps_time) for system in systems]
    names = tuple(name for some, _ in found for name in some)
    return names, KeplerEphemeris(
        *(torch.cat(parts) for parts in zip(*(o for _, o in found), strict=True))
    )


def _offsets(names: tuple[str, ...], options: SatelliteOptions, seed: int) -> Array:
    drawn = {
        system: generator(seed, f"ranges/system_offset/{system}").standard_normal()
        * options.system_offset
        for system in options.systems[1:]
    }
    return np.array([drawn.get(name[0], 0.0) for name in names])


def _text(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(satellite=table["satellite"].astype(str))
