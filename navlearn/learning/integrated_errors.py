"""How far a filter's solution is from a reference once it has settled."""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.attitude import wrap_angle
from navlearn.errors import FitError
from navlearn.frames import enu_between
from navlearn.fusion.options import EkfOptions
from navlearn.learning.referenced_drive import ReferencedDrive
from navlearn.navigator import Navigator, NavigatorOptions
from navlearn.states import Trajectory


class SolutionErrors(NamedTuple):
    """Errors (solution minus reference) of a solution, NaN where the reference is silent.

    Attributes:
        east: m, shape (T,).
        north: m, shape (T,).
        up: m, shape (T,).
        azimuth: rad, within ±π, shape (T,).
        v_e: m/s, shape (T,).
        v_n: m/s, shape (T,).
        v_u: m/s, shape (T,).
    """

    east: Tensor
    north: Tensor
    up: Tensor
    azimuth: Tensor
    v_e: Tensor
    v_n: Tensor
    v_u: Tensor


def solution_errors(solution: Trajectory, reference: Trajectory) -> SolutionErrors:
    """Return the errors of a solution.

    Args:
        solution: Shape (T,) each.
        reference: At the same moments, shape (T,) each, NaN where unknown.
    """
    height = reference.height.nan_to_num()
    east, north, up = enu_between(
        solution.lat, solution.lon, solution.height, reference.lat, reference.lon, height
    )
    return SolutionErrors(
        east,
        north,
        torch.where(reference.height.isfinite(), up, torch.nan),
        wrap_angle(solution.azimuth - reference.azimuth),
        solution.v_e - reference.v_e,
        solution.v_n - reference.v_n,
        solution.v_u - reference.v_u,
    )


def integrated_errors(
    drive: ReferencedDrive, options: EkfOptions, settle: float = 60.0
) -> SolutionErrors:
    """Return the errors of the filter over a drive after it has settled.

    Args:
        drive: The drive.
        options: The filter, as it is before it is tuned.
        settle: Time after alignment that is left out, s.

    Raises:
        LogError: The car never drove fast enough to align.
        FitError: Nothing is left after the filter has settled.
    """
    navigator = Navigator(NavigatorOptions(filter=options))
    run = navigator.run(drive.samples, drive.fixes, drive.timing)
    since = torch.cumsum(run.samples.dt, -1)
    settled = since > settle
    if not bool(settled.any()):
        raise FitError(
            f"{drive.name}: the filter ran for {float(since[-1]):.0f} s after its alignment, and "
            f"{settle:g} s of it are left out; use a longer drive"
        )
    # the reference begins one place earlier, before the first interval
    reference = Trajectory(*(channel[run.first + 1 :][settled] for channel in drive.reference))
    solution = Trajectory(*(channel[settled] for channel in run.history.trajectory))
    return solution_errors(solution, reference)


def mean_squares(errors: list[SolutionErrors]) -> dict[str, float]:
    """Return the mean square of every state, by name, over the moments at which it is known.

    Args:
        errors: Of one drive or several.
    """
    found: dict[str, float] = {}
    for name in SolutionErrors._fields:
        values = torch.cat([getattr(one, name) for one in errors])
        known = values[values.isfinite()]
        if len(known):
            found[name] = float(known.square().mean())
    return found
