"""What a strapdown mechanization refuses before it starts."""

from collections.abc import Mapping, Sequence

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
    batch = tuple(dt.shape[:-1])
    fields = dict(zip(start._fields, start, strict=True))
    check_fields(where, fields, (batch, batch, batch, (*batch, 3), (*batch, 4)), dt)


def check_fields(
    where: str, fields: Mapping[str, Tensor], shapes: Sequence[tuple[int, ...]], dt: Tensor
) -> None:
    """Refuse the fields of a start that have other shapes than expected, or are not float64.

    Args:
        where: Name of the function, for the message.
        fields: The start's fields by name.
        shapes: What is expected of each.
        dt: Length of the intervals, s, shape (..., T).

    Raises:
        ShapeError: If a field differs.
    """
    for (name, value), expected in zip(fields.items(), shapes, strict=True):
        if tuple(value.shape) != tuple(expected):
            raise ShapeError(
                f"{where}: start.{name} has shape {tuple(value.shape)}, dt {tuple(dt.shape)}; "
                f"expected {tuple(expected)}: one start per record"
            )
        if value.dtype != torch.float64:
            raise ShapeError(
                f"{where}: start.{name} is {value.dtype}; positions on the Earth need float64 "
                "(float32 rounds them to half a metre): convert it with .double()"
            )
