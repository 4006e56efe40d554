"""What a strapdown mechanization refuses before it starts."""

import torch
from torch import Tensor

from navlearn.errors import ShapeError
from navlearn.states import InsState


def check_start(where: str, start: InsState, dt: Tensor) -> None:
    """Refuse a start that does not go with its samples.

    Args:
        where: Name of the function, for the message.
        start: State before the first interval.
        dt: Length of the intervals, s, shape (..., T).

    Raises:
        ShapeError: If a shape differs from the samples' batch shape, or a field is not float64.
    """
    batch = dt.shape[:-1]
    expected = {"v_l": (*batch, 3), "q_lb": (*batch, 4)}
    for name, value in zip(start._fields, start, strict=True):
        shape = expected.get(name, tuple(batch))
        if tuple(value.shape) != shape:
            raise ShapeError(
                f"{where}: start.{name} has shape {tuple(value.shape)}, dt {tuple(dt.shape)}; "
                f"expected {shape}: one start per record"
            )
        if value.dtype != torch.float64:
            raise ShapeError(
                f"{where}: start.{name} is {value.dtype}; geodetic angles need float64 "
                "(float32 rounds positions to half a metre): convert it with .double()"
            )
