"""Dilution of precision: what the geometry of satellites makes of an error of one metre.

Source: [Groves2013] §9.4.3.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from navlearn.gnss.least_squares import weighted_least_squares


class Dilution(NamedTuple):
    """Dilution of precision, infinite where satellites do not suffice; shape (...) each.

    Attributes:
        gdop: Of position and the clocks of all systems received.
        pdop: Of position.
        hdop: Of east and north.
        vdop: Of height.
        tdop: Of the first system's clock; infinite where it is not received.
    """

    gdop: Tensor
    pdop: Tensor
    hdop: Tensor
    vdop: Tensor
    tdop: Tensor


def dilution(unit: Tensor, visible: Tensor, system: Tensor | None = None) -> Dilution:
    """Return the dilution of precision of satellites of equal noise.

    [Groves2013] Eqs. (9.138)–(9.140).

    Args:
        unit: Unit vectors from car to satellite, east, north, up, shape (..., S, 3); finite also
            where not visible.
        visible: 1.0 (or true) for satellites that are used, shape (..., S).
        system: Index of each satellite's system, int64, shape (..., S); by default all are of
            one. Each system that is visible costs a clock.
    """
    weight = visible.to(unit.dtype)
    if system is None:
        clocks = torch.ones_like(unit[..., :1])
    else:
        systems = int(system.max()) + 1 if system.numel() else 1
        index = torch.arange(systems, device=unit.device)
        clocks = (system.unsqueeze(-1) == index).to(unit.dtype).expand(*unit.shape[:-1], systems)
    design = torch.cat((-unit, clocks), dim=-1)
    found = weighted_least_squares(design, torch.zeros_like(weight), weight)
    variance = torch.where(found.observed, found.cofactor.diagonal(dim1=-2, dim2=-1), 0.0)
    east, north, up = variance[..., 0], variance[..., 1], variance[..., 2]
    clock = torch.where(found.observed[..., 3], variance[..., 3], torch.inf)

    def root(value: Tensor) -> Tensor:
        return torch.where(found.solvable, value, torch.inf).sqrt()

    return Dilution(
        gdop=root(variance.sum(-1)),
        pdop=root(east + north + up),
        hdop=root(east + north),
        vdop=root(up),
        tdop=root(clock),
    )
