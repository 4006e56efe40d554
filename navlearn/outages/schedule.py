"""Outages as they are written down: one outage, and the protocol that places several."""

import itertools
import math
import re
from dataclasses import dataclass

from navlearn.errors import ConfigError

PLACEMENTS = ("spread", "listed", "random", "by_dynamics")
DYNAMICS = ("straight", "turn", "stop", "motorway", "hill")
UNSCORED = "outage not scored: "
"""How the reason begins why an outage that was placed is left out."""

VISIBLE = ("highest", "best_geometry", "worst_geometry", "random", "listed")


@dataclass(frozen=True)
class Outage:
    """A stretch of a drive through which GNSS gives no fix.

    Attributes:
        start: First time without a fix, s; a fix at this time is already gone.
        duration: Length, s.
        satellites_visible: Satellites whose raw ranges stay, by name, for tight coupling;
            position fixes are gone whatever stands here.
    """

    start: float
    duration: float
    satellites_visible: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not math.isfinite(self.start):
            raise ConfigError(f"outage: start is {self.start}; expected a time in seconds")
        if not (math.isfinite(self.duration) and self.duration > 0.0):
            raise ConfigError(
                f"outage at {self.start:g} s: duration is {self.duration:g} s; expected a "
                "positive number of seconds"
            )

    @property
    def end(self) -> float:
        """Last time of the outage, s."""
        return self.start + self.duration


@dataclass(frozen=True, kw_only=True)
class OutageProtocol:
    """How outages are placed on a drive, stated before anything is scored.

    Attributes:
        placement: ``spread``: evenly over the good stretches; ``listed``: at ``times``;
            ``random``: drawn with ``seed``; ``by_dynamics``: as many of each of ``classes``.
        count: Number of outages; ignored by ``listed``, which has one per entry of ``times``.
        fewer: Whether a drive into which fewer fit (one at least) has fewer.
        duration: Length of each, s.
        warm_up: No outage starts earlier than this after sensors and reference are both there,
            s (not applied to ``listed``).
        warm_up_moving: Nor before the car has moved this long, s (not applied to ``listed``):
            a parked car teaches no azimuth.
        min_gap: Shortest time from the end of one outage to the start of the next, s.
        seed: Of the draw of ``random``.
        times: Starts of the ``listed`` outages, log time, s; they may be closer than ``min_gap``.
        classes: Dynamics that ``by_dynamics`` looks for, in this order.
        min_mean_speed: Lowest mean speed through an outage, m/s, so that parked cars do not
            count as successes; ``listed`` does without, ``stop`` outages need half of it.
        max_fix_interval: Good GNSS has fixes at most this far apart, s ...
        good_before: ... through the outage and this long before it, s.
        max_reference_interval: A reference with a longer hole in an outage is bad there, s.
        max_reference_slip: A reference whose change of position differs by more than this from
            the integral of its own velocity is bad there, m ...
        slip_span: ... compared over this many seconds.
        satellites: Satellites whose raw ranges stay through an outage; 0 takes all GNSS away.
        visible: By which rule they are chosen among those that could stay:
            ``highest`` elevation; ``best_geometry`` and ``worst_geometry``
            (:func:`navlearn.outages.visible.information`); ``random``, with ``seed``; ``listed``,
            the first of ``visible_satellites``.
        visible_satellites: Names, such as ``G07``, for ``listed``.
        min_tracked: A satellite could stay if it is among at least this share of the receptions
            through the outage, ...
        min_elevation: ... and stands at least so high when the outage starts, rad.
        min_satellites: An outage through which fewer could stay is not scored, nor one through
            which fewer than ``satellites`` could: so that outages with different numbers of
            satellites are the same ones.
    """

    placement: str = "spread"
    count: int = 10
    fewer: bool = False
    duration: float = 60.0
    warm_up: float = 300.0
    warm_up_moving: float = 60.0
    min_gap: float = 30.0
    seed: int = 0
    times: tuple[float, ...] = ()
    classes: tuple[str, ...] = DYNAMICS
    min_mean_speed: float = 2.0
    max_fix_interval: float = 3.5
    good_before: float = 30.0
    max_reference_interval: float = 3.5
    max_reference_slip: float = 5.0
    slip_span: float = 10.0
    satellites: int = 0
    visible: str = "highest"
    visible_satellites: tuple[str, ...] = ()
    min_tracked: float = 0.9
    min_elevation: float = math.radians(10.0)
    min_satellites: int = 0

    def __post_init__(self) -> None:
        if self.placement not in PLACEMENTS:
            raise ConfigError(
                f"outages: placement is {self.placement!r}; expected one of {', '.join(PLACEMENTS)}"
            )
        if (self.placement == "listed") != bool(self.times):
            raise ConfigError(
                f"outages: placement {self.placement!r} with {len(self.times)} times; give "
                "times with placement 'listed', and only there"
            )
        if self.count < 1:
            raise ConfigError(f"outages: count is {self.count}; expected at least 1")
        unknown = [name for name in self.classes if name not in DYNAMICS]
        if unknown or not self.classes or len(set(self.classes)) != len(self.classes):
            raise ConfigError(
                f"outages: classes are {list(self.classes)}; expected some of "
                f"{', '.join(DYNAMICS)}, each once"
            )
        self._refuse_negative()
        self._refuse_satellites()

    def _refuse_satellites(self) -> None:
        if self.visible not in VISIBLE:
            raise ConfigError(
                f"outages: visible is {self.visible!r}; expected one of {', '.join(VISIBLE)}"
            )
        for name in ("satellites", "min_satellites"):
            if getattr(self, name) < 0:
                raise ConfigError(
                    f"outages: {name} is {getattr(self, name)}; expected zero or more"
                )
        named = len(self.visible_satellites)
        if (self.visible == "listed") != bool(named) or len(set(self.visible_satellites)) < named:
            raise ConfigError(
                f"outages: visible is {self.visible!r} and visible_satellites are "
                f"{list(self.visible_satellites)}; list names, each once, with visible 'listed', "
                "and only there"
            )
        if named and max(self.satellites, self.min_satellites) > named:
            raise ConfigError(
                f"outages: {max(self.satellites, self.min_satellites)} satellites are to stay, but "
                f"visible_satellites lists {named}; list more"
            )
        if not 0.0 < self.min_tracked <= 1.0:
            raise ConfigError(
                f"outages: min_tracked is {self.min_tracked}; expected a share above 0, up to 1"
            )
        if not 0.0 <= self.min_elevation < 0.5 * math.pi:
            raise ConfigError(
                f"outages: min_elevation is {self.min_elevation} rad; expected one from the "
                "horizon to below the zenith"
            )

    def _refuse_negative(self) -> None:
        for name in ("duration", "max_fix_interval", "max_reference_interval", "slip_span"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"outages: {name} is {value}; expected a positive number")
        names = ("warm_up", "warm_up_moving", "min_gap", "min_mean_speed", "good_before")
        for name in (*names, "max_reference_slip"):
            value = getattr(self, name)
            if not value >= 0.0:
                raise ConfigError(f"outages: {name} is {value}; expected zero or more")


@dataclass(frozen=True)
class Exclusion:
    """A stretch on which no outage is scored.

    Attributes:
        start: First time, s.
        end: Last time, s.
        reason: Which rule excludes it, with the figure that broke it.
    """

    start: float
    end: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Outages placed on one drive.

    Attributes:
        outages: In order of time, not overlapping.
        dynamics: One word of :data:`DYNAMICS` per outage.
        excluded: Where the reference is too bad to score, and outages asked for there.
        notes: What a reader of the result should know about the placement.
    """

    outages: tuple[Outage, ...]
    dynamics: tuple[str, ...]
    excluded: tuple[Exclusion, ...] = ()
    notes: tuple[str, ...] = ()


def parse_outages(text: str) -> tuple[int, float]:
    """Return count and duration of a text such as ``10x60``.

    Args:
        text: Count, ``x`` (or ``×``), seconds.

    Returns:
        Number of outages, and the length of each, s.

    Raises:
        ConfigError: The text has another form, or a number is not positive.
    """
    match = re.fullmatch(r"\s*(\d+)\s*[xX×]\s*(\d+(?:\.\d*)?)\s*s?\s*", text)
    if match is None or int(match[1]) == 0 or float(match[2]) == 0.0:
        raise ConfigError(
            f"outages: found {text!r}; expected COUNTxSECONDS, such as 10x60 for ten outages "
            "of 60 s"
        )
    return int(match[1]), float(match[2])


def refuse_overlaps(outages: tuple[Outage, ...], where: str = "outages") -> None:
    """Raise if outages are out of order or overlap.

    Args:
        outages: The outages.
        where: What they belong to, for the message.

    Raises:
        ConfigError: Two outages share time.
    """
    for before, after in itertools.pairwise(outages):
        if after.start < before.end:
            raise ConfigError(
                f"{where}: the outage from {before.start:g} to {before.end:g} s overlaps the one "
                f"that starts at {after.start:g} s; sort them and move them apart"
            )
