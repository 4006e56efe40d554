"""Process noise and initial covariance as [Ghouneem2024] prints them, Eqs. (12) and (13).

The diagonals of Q and P₀ are the averages of reference minus RISS, run on over the whole drive,
and of reference minus the integrated solution. An average of signed differences is no variance:
it is negative as often as not, has the wrong unit, and grows with the drive. It is computed here to
be compared with, and refused as a filter's noise where it is negative.
"""

from typing import NamedTuple

import torch

from navlearn.errors import FitError
from navlearn.fusion.options import EkfOptions
from navlearn.learning.integrated_errors import (
    SolutionErrors,
    integrated_errors,
    solution_errors,
)
from navlearn.learning.referenced_drive import ReferencedDrive, states_at
from navlearn.mechanization.riss_parallel import riss_over_time
from navlearn.states import RissSample, Trajectory

EVERY = 1.0
"""Time over which Q is added once: the step of that paper's filter from fix to fix, s."""

_NOISE = {
    "position_walk": ("east", "north"),
    "height_walk": ("up",),
    "hill_walk": ("up",),
    "velocity_walk": ("v_e", "v_n", "v_u"),
    "gyro_random_walk": ("azimuth",),
}
_INITIAL = {
    "position": ("east", "north"),
    "height": ("up",),
    "velocity": ("v_e", "v_n", "v_u"),
    "azimuth": ("azimuth",),
}


class PrintedDiagonals(NamedTuple):
    """What the printed rule gives, signed.

    Attributes:
        process: Q by state (m, rad and m/s, standing for their squares).
        initial: P₀ by state, likewise.
    """

    process: dict[str, float]
    initial: dict[str, float]

    @property
    def negative(self) -> tuple[str, ...]:
        """Entries that are no variances, such as ``Q[east]``."""
        named = (("Q", self.process), ("P0", self.initial))
        return tuple(
            f"{matrix}[{state}]"
            for matrix, entries in named
            for state, value in entries.items()
            if value < 0.0
        )


def printed_diagonals(drive: ReferencedDrive, options: EkfOptions) -> PrintedDiagonals:
    """Return Q and P₀ as printed.

    Args:
        drive: The drive.
        options: The filter, as it is before it is tuned.

    Raises:
        FitError: The reference tells no azimuth from which RISS could start.
        LogError: The car never drove fast enough to align.
    """
    return PrintedDiagonals(
        _averages(riss_errors(drive, options)), _averages(integrated_errors(drive, options))
    )


def riss_errors(drive: ReferencedDrive, options: EkfOptions) -> SolutionErrors:
    """Return the errors of RISS alone, run on from the reference's first state.

    Args:
        drive: The drive.
        options: Tells the mechanization.

    Raises:
        FitError: The reference tells no state from which RISS could start.
    """
    reference = drive.reference
    known = torch.stack((reference.lat, reference.lon, reference.azimuth)).isfinite().all(0)
    if not bool(known[:-1].any()):
        raise FitError(f"{drive.name}: its reference tells no state from which RISS could start")
    first = int(torch.nonzero(known)[0])
    start = states_at(reference, torch.tensor(first))
    start = start._replace(height=start.height.nan_to_num())
    samples = RissSample(*(channel[first:] for channel in drive.samples))
    ran = riss_over_time(start, samples, options=options.mechanization)
    after = Trajectory(*(channel[first + 1 :] for channel in reference))
    errors = solution_errors(ran, after)
    # run on, an azimuth may be wrong by more than half a turn
    return errors._replace(azimuth=ran.azimuth - after.azimuth)


def printed_options(
    diagonals: PrintedDiagonals, options: EkfOptions, *, absolute: bool
) -> dict[str, dict[str, float]]:
    """Return the options of a filter that has the printed Q and P₀.

    Entries that share an option (east and north) enter it by their mean.

    Args:
        diagonals: As printed.
        options: The filter: entries that it has no state for are left out.
        absolute: Whether the absolute values are taken, without which there may be no filter.

    Raises:
        FitError: An entry is negative, and absolute values are not asked for.
    """
    if diagonals.negative and not absolute:
        raise FitError(
            f"ghouneem2024: {', '.join(diagonals.negative)} negative: averages of signed "
            "differences are no variances, and their roots are not numbers; take the rule "
            "ghouneem2024_absolute to see what their sizes do, or increments, which are variances"
        )
    noise = _roots(diagonals.process, _NOISE)
    unused = {"hill_walk" if options.mechanization.three_d else "height_walk"}
    unused |= set() if options.has_velocity_states else {"velocity_walk"}
    noise = {name: value / EVERY**0.5 for name, value in noise.items() if name not in unused}
    initial = _roots(diagonals.initial, _INITIAL)
    if not options.has_velocity_states:
        initial.pop("velocity", None)
    return {"noise": noise, "initial": initial}


def _roots(entries: dict[str, float], of: dict[str, tuple[str, ...]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, states in of.items():
        values = [abs(entries[state]) for state in states if state in entries]
        if values:
            found[name] = (sum(values) / len(values)) ** 0.5
    return found


def _averages(errors: SolutionErrors) -> dict[str, float]:
    """Return averages of reference minus solution by state."""
    found: dict[str, float] = {}
    for name, values in errors._asdict().items():
        known = values[values.isfinite()]
        if len(known):
            found[name] = -float(known.mean())
    return found
