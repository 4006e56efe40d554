"""Solutions through an outage as tables, whatever filter or mechanization they come from."""

import numpy as np
import pandas as pd
import torch

from navlearn import attitude
from navlearn.outages.schedule import Outage
from navlearn.states import InsState, Trajectory


def solution_table(t: torch.Tensor, trajectory: Trajectory, outage: Outage) -> pd.DataFrame:
    """Return a trajectory through an outage as a table, one sample before it included.

    Args:
        t: Times of the trajectory, s, shape (T,).
        trajectory: Solution, shape (T,) each.
        outage: The outage.
    """
    times, through = t.numpy(), _through(t.numpy(), outage)
    columns = {name: getattr(trajectory, name)[through] for name in Trajectory._fields}
    return pd.DataFrame(
        {"t": times[through], **{name: v.detach().numpy() for name, v in columns.items()}}
    )


def ins_solution_table(t: torch.Tensor, path: InsState, outage: Outage) -> pd.DataFrame:
    """Return a full-IMU solution through an outage as a table, one sample before it included.

    Args:
        t: Times of the solution, s, shape (T,).
        path: Solution, shape (T,) each.
        outage: The outage.

    Returns:
        The columns of a solution table, and ``v_u`` (m/s), ``pitch`` and ``roll`` (rad).
    """
    times, through = t.numpy(), _through(t.numpy(), outage)
    part = InsState(*(channel[through].detach() for channel in path))
    azimuth, pitch, roll = attitude.angles_from_matrix(attitude.matrix_from_quaternion(part.q_lb))
    v_e, v_n, v_u = part.v_l.unbind(-1)
    columns = {
        "lat": part.lat,
        "lon": part.lon,
        "height": part.height,
        "v_e": v_e,
        "v_n": v_n,
        "v_u": v_u,
        "azimuth": azimuth,
        "pitch": pitch,
        "roll": roll,
    }
    return pd.DataFrame({"t": times[through], **{k: v.numpy() for k, v in columns.items()}})


def with_deviations(
    table: pd.DataFrame, ends: torch.Tensor, covariance: torch.Tensor
) -> pd.DataFrame:
    """Return a solution table with the standard deviations of its horizontal position.

    Args:
        table: The table.
        ends: Times at which the covariance is known, s, shape (K,).
        covariance: Of the position error east and north, m², shape (K, 2, 2).
    """
    known = covariance.detach()
    spread = {
        "std_e": known[:, 0, 0].clamp(min=0.0).sqrt(),
        "std_n": known[:, 1, 1].clamp(min=0.0).sqrt(),
        "cov_en": known[:, 0, 1],
    }
    at = table["t"].to_numpy()
    return table.assign(
        **{name: np.interp(at, ends.numpy(), values.numpy()) for name, values in spread.items()}
    )


def _through(times: np.ndarray, outage: Outage) -> slice:
    """Return the samples of an outage and the one before it."""
    first = max(int(np.searchsorted(times, outage.start, side="right")) - 1, 0)
    return slice(first, int(np.searchsorted(times, outage.end + 1e-9, side="right")))
