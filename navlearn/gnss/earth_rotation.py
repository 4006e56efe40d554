"""The Earth turns while a signal travels.

Source: [Groves2013] §8.5.3.
"""

import torch
from torch import Tensor

from navlearn import wgs84


def in_axes_of_reception(position: Tensor, travel_time: Tensor) -> Tensor:
    """Return a vector of the moment of sending in the Earth-fixed axes of reception.

    [Groves2013] §8.5.3, without small angles. Positions and velocities against the
    Earth alike; a travel time below zero turns back.

    Args:
        position: Vector in Earth-fixed axes of the moment of sending, shape (..., 3).
        travel_time: Time from sending to reception, s, shape (...).

    Returns:
        The same vector in Earth-fixed axes of the moment of reception, shape (..., 3).
    """
    angle = wgs84.EARTH_RATE * travel_time
    s, c = torch.sin(angle), torch.cos(angle)
    x, y, z = position.unbind(-1)
    return torch.stack((c * x + s * y, c * y - s * x, z.expand_as(s * x)), dim=-1)
