"""A filter tuned from drives with a reference, by what dead reckoning and filter do wrong there.

[Ghouneem2024] (12), (13). The rule ``increments`` is the sane reading: Q from mean squares of
increments of dead reckoning's error, P₀ from mean squares of the filter's own, R from the errors of
fixes. ``ghouneem2024`` is what is printed. What is tuned on a drive is to be judged on others.
"""

from collections.abc import Sequence
from typing import Any, Final, Literal

from navlearn.errors import ConfigError, FitError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.ghouneem2024 import PrintedDiagonals, printed_diagonals, printed_options
from navlearn.learning.increment_noise import FoundNoise, increment_noise, over_drives
from navlearn.learning.integrated_errors import integrated_errors, mean_squares
from navlearn.learning.receiver_noise import receiver_noise
from navlearn.learning.reference_increments import reference_increments
from navlearn.learning.referenced_drive import ReferencedDrive
from navlearn.learning.tuned_values import TunedValues

FixErrors = Literal["lasting", "white"]
Rule = Literal["increments", "ghouneem2024", "ghouneem2024_absolute"]

RULES: Final[tuple[Rule, ...]] = ("increments", "ghouneem2024", "ghouneem2024_absolute")
"""The rules by name."""

BELIEVED: Final = 4
"""For how many drives the deviation of a sensor parameter that was believed before counts."""


def tuned_by_differences(
    drives: Sequence[ReferencedDrive],
    options: EkfOptions,
    rule: Rule = "increments",
    *,
    span: float = 1.0,
    fix_errors: FixErrors = "lasting",
) -> TunedValues:
    """Return the options of a filter as differences from a reference tell them.

    Args:
        drives: Drives with a reference, at least one; ``ghouneem2024`` averages over them.
        options: The filter as it is now. What is not found stays.
        rule: ``increments``; ``ghouneem2024`` as printed, which is refused where an average is
            negative; ``ghouneem2024_absolute``, the same with the signs dropped.
        span: Length of the increments, s.
        fix_errors: How R of ``increments`` takes the errors of fixes: ``lasting``, with the
            variance of white noise that would say as little as errors that last from fix to fix
            do; or ``white``, as if each fix erred anew, which makes a filter far too sure of its
            position.

    Raises:
        ConfigError: The rule is unknown.
        FitError: The reference tells too little, or the printed rule gives negative variances.
        LogError: The car never drove fast enough to align.
    """
    if rule not in RULES:
        raise ConfigError(f"rule: found {rule!r}; choose among {', '.join(RULES)}")
    if not drives:
        raise FitError("tuning: no drive was given; give one or more with a reference")
    if rule == "increments":
        return _by_increments(drives, options, span, fix_errors)
    return _as_printed(drives, options, absolute=rule == "ghouneem2024_absolute")


def _by_increments(
    drives: Sequence[ReferencedDrive], options: EkfOptions, span: float, fix_errors: FixErrors
) -> TunedValues:
    increments = [reference_increments(drive, options, span) for drive in drives]
    stretches = [len(one.way) for one in increments]
    found = [increment_noise(one, options) for one in increments]
    squares = mean_squares([integrated_errors(drive, options) for drive in drives])
    receiver = receiver_noise(list(drives), lasting=fix_errors == "lasting")
    return TunedValues(
        filter={
            "noise": {**over_drives(found, stretches), **receiver.noise},
            "initial": {
                **_initial_navigation(squares, options),
                **_initial_sensors(found, options),
            },
        },
        figures={
            "stretches": sum(stretches),
            "stretch_s": increments[0].span,
            "integrated_rms": {name: value**0.5 for name, value in squares.items()},
            "fixes_per_independent_fix": receiver.lasting,
        },
        notes=(
            "Q: mean squares of increments of dead reckoning minus reference; P0: mean squares of "
            "filter minus reference; R: errors of fixes. Where alignment tells position, azimuth "
            "and gyro bias with deviations of its own, those count at the start.",
        ),
    )


def _initial_navigation(squares: dict[str, float], options: EkfOptions) -> dict[str, float]:
    """Return standard deviations at the start: those of the settled filter."""
    named = {"position": ("east", "north"), "height": ("up",), "azimuth": ("azimuth",)}
    if options.has_velocity_states:
        named["velocity"] = ("v_e", "v_n", "v_u")
    told: dict[str, float] = {}
    for name, states in named.items():
        known = [squares[state] for state in states if state in squares]
        if known:
            told[name] = (sum(known) / len(known)) ** 0.5
    return told


def _initial_sensors(found: list[FoundNoise], options: EkfOptions) -> dict[str, Any]:
    """Return standard deviations of sensor parameters, which every drive tells but once.

    What was believed before counts as some drives, too: from one drive whose scale happens to be
    right nobody should conclude that scales are.
    """
    told: dict[str, Any] = {}
    for name in dict.fromkeys(name for one in found for name in one.parameters):
        values = [one.parameters[name] for one in found if name in one.parameters]
        group, _, term = name.partition("_")
        grouped = group in ("gyro", "speed")
        before = getattr(options.initial, group)[term] if grouped else options.initial.pitch_bias
        total = BELIEVED * before**2 + sum(value**2 for value in values)
        sigma = (total / (BELIEVED + len(values))) ** 0.5
        if grouped:
            told.setdefault(group, {})[term] = sigma
        else:
            told[name] = sigma
    return told


def _as_printed(
    drives: Sequence[ReferencedDrive], options: EkfOptions, *, absolute: bool
) -> TunedValues:
    each = [printed_diagonals(drive, options) for drive in drives]
    both = PrintedDiagonals(
        _mean([one.process for one in each]), _mean([one.initial for one in each])
    )
    chosen: dict[str, Any] = printed_options(both, options, absolute=absolute)
    # the receiver's deviations are taken as told
    chosen["noise"] |= {"position_inflation": 1.0, "velocity_inflation": 1.0}
    chosen["noise"] |= {"position_floor": 0.0, "height_floor": 0.0, "velocity_floor": 0.0}
    notes = ["Q and P0: averages of signed differences from the reference, once per second"]
    if both.negative:
        notes.append(f"negative, and so no variances: {', '.join(both.negative)}; signs dropped")
    return TunedValues(
        filter=chosen,
        figures={"process": dict(both.process), "initial": dict(both.initial)},
        notes=tuple(notes),
    )


def _mean(entries: list[dict[str, float]]) -> dict[str, float]:
    names = [name for name in entries[0] if all(name in one for one in entries)]
    return {name: sum(one[name] for one in entries) / len(entries) for name in names}
