"""What a simulated GNSS receiver sees and how wrong its ranges are: figures and presets.

Deviations of pseudoranges are those left when broadcast clock, ionosphere and troposphere have
been taken off. The parts are those of usual error budgets ([Groves2013] §9.3); the clock's figures
are those of a temperature-compensated crystal.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Final, Literal

from navlearn.errors import ConfigError
from navlearn.logs.nearest import nearest_hint

SYSTEMS: Final = ("G", "E", "R")
"""Systems that are simulated, by their RINEX letter: GPS, Galileo, GLONASS."""

_ANY: Final = (-math.inf, math.inf)
_SHARE: Final = (0.0, 1.0)
_TIME: Final = (1.0, math.inf)
_ANGLE: Final = (0.0, 90.0)
_LIMITS: Final = {
    "lowest_deg": _ANGLE,
    "fading_time": _TIME,
    "ionosphere_time": _TIME,
    "ionosphere_shared": _SHARE,
    "troposphere_time": _TIME,
    "orbit_time": _TIME,
    "multipath_time": _TIME,
    "multipath_speed": (0.1, math.inf),
    "reflection_shortest": _TIME,
    "canyon_share": _SHARE,
    "canyon_length": (1.0, math.inf),
    "canyon_deg": _ANGLE,
    "canyon_reflected": _SHARE,
    "clock": _ANY,
    "clock_rate": _ANY,
}
"""Least and most of what may not be any figure of zero or more."""


@dataclass(frozen=True, kw_only=True)
class SatelliteOptions:
    """Satellites, streets and receiver; deviations unless said otherwise.

    All draws come from the seed of the drive; what is zero is left out.

    Attributes:
        systems: Systems received, by RINEX letter: G, E, R.
        gps_time: What t = 0 of the drive is, GPS seconds since 6 January 1980; None draws a
            moment of GPS week 2400.
        lowest_deg: Satellites lower than this are not received, degrees.
        cn0_zenith: Mean C/N0 in the zenith, dB-Hz.
        cn0_horizon: Mean C/N0 on the horizon, dB-Hz; between them it goes with the sine.
        fading: Fading of C/N0, Gauss–Markov, dB.
        fading_time: Correlation time of the fading, s.
        cn0_threshold: Weaker satellites are not received, dB-Hz.
        thermal: White noise of the code at 45 dB-Hz, m; doubles for every 6 dB less.
        rate_thermal: White noise of the range rate at 45 dB-Hz, m/s, likewise.
        ionosphere: What is left of the ionosphere in the zenith, Gauss–Markov, m.
        ionosphere_time: Its correlation time, s.
        ionosphere_shared: Share of its variance that all satellites have in common, 0 to 1.
        troposphere: What is left of the troposphere in the zenith, Gauss–Markov, one for all
            satellites, m.
        troposphere_time: Its correlation time, s.
        orbit: Broadcast orbit and clock of each satellite, Gauss–Markov, m.
        orbit_time: Their correlation time, s.
        multipath: Multipath of a standing car in the zenith, Gauss–Markov, m; grows as
            1 / sin(elevation).
        multipath_time: Its correlation time when the car stands, s.
        multipath_speed: Speed that halves the variance of multipath and its correlation time,
            m/s.
        reflections_per_hour: How often a satellite on the horizon is received by reflection
            alone; seldomer by the squared cosine of the elevation.
        reflection: Mean of the detour of a reflected signal, exponentially distributed, m.
        reflection_shortest: Shortest time of a reflection, s.
        reflection_longest: Longest time, s; between them it is log-uniform.
        reflection_loss: Mean of what a reflection costs, dB, spread by a quarter of it.
        reflection_rate: Error of the range rate of a reflected signal, as a share of the speed.
        canyon_share: Share of the way between houses that mask satellites, 0 to 1.
        canyon_length: Mean length of such a street, m.
        canyon_deg: Mean elevation of the roofs across the street, degrees.
        canyon_spread_deg: Spread of that elevation from street to street and side to side.
        canyon_reflected: Share of the masked satellites that are received by reflection.
        clock: Receiver clock at the start, m.
        clock_rate: Its rate at the start, m/s.
        clock_white: White frequency noise, growth of the clock, m/√s.
        clock_walk: Random walk of the frequency, growth of the rate, (m/s)/√s.
        clock_jump: Steps by which the receiver sets its clock when it is half a step off, s;
            zero lets it run.
        system_offset: Offset of each further system's time against the first one's, m.
        systematic: Error that follows from elevation and the C/N0 of the last ten receptions alone
            and that a model could learn, m; no receiver is known to have it.
        fixes: Where the fixes come from: ``single_point`` solves the ranges, ``drawn`` takes the
            grade's figures as without satellites.
    """

    systems: tuple[str, ...] = ("G",)
    gps_time: float | None = None
    lowest_deg: float = 7.5
    cn0_zenith: float = 49.0
    cn0_horizon: float = 36.0
    fading: float = 1.0
    fading_time: float = 10.0
    cn0_threshold: float = 25.0
    thermal: float = 0.4
    rate_thermal: float = 0.04
    ionosphere: float = 1.0
    ionosphere_time: float = 1800.0
    ionosphere_shared: float = 0.7
    troposphere: float = 0.08
    troposphere_time: float = 3600.0
    orbit: float = 0.7
    orbit_time: float = 3600.0
    multipath: float = 0.3
    multipath_time: float = 40.0
    multipath_speed: float = 5.0
    reflections_per_hour: float = 0.0
    reflection: float = 15.0
    reflection_shortest: float = 5.0
    reflection_longest: float = 60.0
    reflection_loss: float = 9.0
    reflection_rate: float = 0.1
    canyon_share: float = 0.0
    canyon_length: float = 250.0
    canyon_deg: float = 45.0
    canyon_spread_deg: float = 12.0
    canyon_reflected: float = 0.25
    clock: float = 50e3
    clock_rate: float = 100.0
    clock_white: float = 0.1
    clock_walk: float = 0.02
    clock_jump: float = 0.0
    system_offset: float = 15.0
    systematic: float = 0.0
    fixes: Literal["single_point", "drawn"] = "single_point"

    def __post_init__(self) -> None:
        unknown = [letter for letter in self.systems if letter not in SYSTEMS]
        if not self.systems or unknown or len(set(self.systems)) != len(self.systems):
            raise ConfigError(
                f"satellites: systems: found {list(self.systems)}, expected some of "
                f"{', '.join(SYSTEMS)}, each once"
            )
        if self.fixes not in ("single_point", "drawn"):
            raise ConfigError(
                f"satellites: fixes: found {self.fixes!r}, expected single_point or drawn"
            )
        for entry in fields(self):
            if entry.name not in ("systems", "fixes", "gps_time"):
                self._check(entry.name)

        if self.gps_time is not None and not 0.0 <= self.gps_time < 1e10:
            raise ConfigError(
                f"satellites: gps_time: found {self.gps_time!r}, expected seconds since 6 January "
                "1980"
            )

    def _check(self, name: str) -> None:
        value = getattr(self, name)
        least, most = _LIMITS.get(name, (0.0, math.inf))
        if name == "reflection_longest":
            least = self.reflection_shortest
        if not (math.isfinite(value) and least <= value <= most):
            span = f"{least:g} to {most:g}" if math.isfinite(most) else f"{least:g} or more"
            raise ConfigError(f"satellites: {name}: found {value!r}, expected {span}, finite")


PRESETS: Final[dict[str, SatelliteOptions]] = {
    "open_sky": SatelliteOptions(),
    "suburban": SatelliteOptions(
        cn0_zenith=47.0,
        cn0_horizon=33.0,
        fading=2.5,
        thermal=0.5,
        rate_thermal=0.06,
        multipath=0.7,
        reflections_per_hour=6.0,
        canyon_share=0.1,
        canyon_deg=30.0,
    ),
    "urban": SatelliteOptions(
        cn0_zenith=46.0,
        cn0_horizon=31.0,
        fading=4.0,
        thermal=0.6,
        rate_thermal=0.08,
        multipath=1.0,
        reflections_per_hour=15.0,
        reflection=20.0,
        canyon_share=0.5,
        canyon_deg=45.0,
        canyon_reflected=0.35,
    ),
    "ideal": replace(
        SatelliteOptions(),
        fading=0.0,
        thermal=0.0,
        rate_thermal=0.0,
        ionosphere=0.0,
        troposphere=0.0,
        orbit=0.0,
        multipath=0.0,
    ),
}
"""Skies by name; ``ideal`` has no error but the receiver's clock."""


def find_satellites(satellites: str | SatelliteOptions) -> SatelliteOptions:
    """Return a sky by its name, or the options themselves.

    Raises:
        ConfigError: No preset has this name.
    """
    if isinstance(satellites, SatelliteOptions):
        return satellites
    if satellites not in PRESETS:
        raise ConfigError(
            f"satellites: found {satellites!r}{nearest_hint(satellites, PRESETS)}, expected one of "
            f"{', '.join(PRESETS)}"
        )
    return PRESETS[satellites]
