"""Receptions of any batch laid out along one axis."""

from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.states import SatelliteRanges


def flattened(ranges: SatelliteRanges) -> SatelliteRanges:
    """Return ranges with all their receptions in one axis, systems spread over them.

    Args:
        ranges: Receptions, shape (..., M, S).

    Returns:
        The same of shape (N, S) each, satellites and velocities (N, S, 3).

    Raises:
        ShapeError: The fields do not fit each other.
    """
    shape = ranges.pseudorange.shape
    if len(shape) < 2:
        raise ShapeError(f"ranges: pseudorange has shape {tuple(shape)}; expected (..., M, S)")
    for name, value in ranges._asdict().items():
        wanted: tuple[int, ...] = tuple(shape)
        if name in ("satellite", "satellite_velocity"):
            wanted = (*shape, 3)
        elif name == "system":
            wanted = (*shape[:-2], shape[-1])
        if tuple(value.shape) != wanted:
            raise ShapeError(
                f"ranges: {name} has shape {tuple(value.shape)}; expected {wanted} beside "
                f"pseudoranges of shape {tuple(shape)}"
            )
    wide = ranges._replace(system=ranges.system.unsqueeze(-2).expand(shape))
    return SatelliteRanges(*(_joined(value, len(shape) - 1) for value in wide))


def _joined(value: Tensor, axes: int) -> Tensor:
    return value.reshape(value.shape[:axes].numel(), *value.shape[axes:])
