"""All chunks of the parallel strapdown as one differentiable operation that keeps no tape.

Forward, position and velocity are carried from chunk to chunk and kept at the chunks' starts. The
backward pass goes through the chunks in reverse, computes each again with a tape of its own, and
carries the cotangents of position and velocity back: what is alive at any time fits the cache.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor

from navlearn.mechanization.strapdown_chunk import Chunk, move_chunk

CHUNK_ELEMENTS = 16384
"""Samples in one chunk: of one record, or of as many as are short enough."""

CHUNK_DURATION = 300.0
"""Longest chunk, s: in longer ones the corrections of gravity settle slowly."""


class Piece(NamedTuple):
    """Which records and samples one chunk holds."""

    rows: slice
    part: slice

    def of(self, whole: Chunk, r: Tensor, v: Tensor) -> Chunk:
        """Return the chunk of whole records that starts at a position and a velocity."""
        rows, part = self
        wider = slice(part.start, part.stop + 1)
        return Chunk(
            r,
            v,
            whole.time[rows, part],
            whole.dt[rows, part],
            whole.turn[:, rows, part],
            whole.push[:, rows, part],
            whole.q_w[rows, wider],
            whole.q_x[rows, wider],
            whole.q_y[rows, wider],
            whole.q_z[rows, wider],
            whole.lon[rows],
        )


def chunk_count(dt: Tensor) -> int:
    """Return into how many chunks the time of records is cut.

    Args:
        dt: Length of the intervals, s, shape (B, T).

    Returns:
        Chunks, at least one.
    """
    records, length = dt.shape
    if records == 0 or length == 0:
        return 1
    duration = float(dt.detach().sum(-1).amax())
    return max(-(-length // CHUNK_ELEMENTS), math.ceil(duration / CHUNK_DURATION), 1)


def pieces(dt: Tensor, count: int) -> Iterator[list[Piece]]:
    """Yield groups of records, each as its chunks in order of time.

    Args:
        dt: Length of the intervals, s, shape (B, T).
        count: Chunks of each record, at most.

    Yields:
        The chunks of some records.
    """
    records, length = dt.shape
    if length == 0:
        return
    size = max(-(-length // count), 1)
    many = max(CHUNK_ELEMENTS // size, 1)
    for row in range(0, records, many):
        rows = slice(row, min(row + many, records))
        yield [Piece(rows, slice(k, min(k + size, length))) for k in range(0, length, size)]


def solve(whole: Chunk) -> tuple[Tensor, Tensor, Tensor]:
    """Return the solution over whole records; reverse mode, once.

    Args:
        whole: The records as one chunk.

    Returns:
        Place (3, B, T), velocity (3, B, T) and attitude (4, B, T), as
        :class:`navlearn.mechanization.strapdown_chunk.Solved`.
    """
    place, v, attitude, _ = _Solve.apply(*whole)  # type: ignore[no-untyped-call]
    return place, v, attitude


class _Solve(torch.autograd.Function):
    """Chunk -> place, velocity, attitude, and position and velocity at the starts of chunks."""

    @staticmethod
    def forward(*tensors: Tensor) -> tuple[Tensor, ...]:
        whole = Chunk(*tensors)
        place, v_l = torch.empty_like(whole.turn), torch.empty_like(whole.turn)
        attitude = whole.dt.new_empty((4, *whole.dt.shape))
        count = chunk_count(whole.dt)
        starts = whole.r.new_zeros((6, whole.r.shape[1], count))
        for group in pieces(whole.dt, count):
            rows = group[0].rows
            r, v = whole.r[:, rows], whole.v[:, rows]
            for k, piece in enumerate(group):
                starts[:3, rows, k : k + 1], starts[3:, rows, k : k + 1] = r, v
                done = move_chunk(piece.of(whole, r, v))
                place[:, rows, piece.part] = done.place
                v_l[:, rows, piece.part] = done.v
                attitude[:, rows, piece.part] = done.attitude
                r, v = done.r_end, done.v_end
        return place, v_l, attitude, starts

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(output[3])
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*inputs, output[3])

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor | None) -> tuple[Tensor | None, ...]:
        *tensors, starts = ctx.saved_tensors
        dt = tensors[3]
        given = [
            dt.new_zeros((axes, *dt.shape)) if g is None else g
            for axes, g in zip((3, 3, 4), cotangents[:3], strict=True)
        ]
        wanted = sum(2**k for k, needed in enumerate(ctx.needs_input_grad) if needed)
        found = _Adjoint.apply(*given, *tensors, starts, wanted)  # type: ignore[no-untyped-call]
        return tuple(x if wanted >> k & 1 else None for k, x in enumerate(found))

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
        return _apply_batched(_Solve, info.batch_size, in_dims, inputs)


class _Adjoint(torch.autograd.Function):
    """Cotangents of _Solve's outputs, its inputs and starts -> cotangents of its inputs."""

    @staticmethod
    def forward(*inputs: Any) -> tuple[Tensor, ...]:
        given, whole = inputs[:3], Chunk(*inputs[3:-2])
        starts, wanted = inputs[-2:]
        found = Chunk(*(torch.zeros_like(x) for x in whole))
        for group in pieces(whole.dt, starts.shape[-1]):
            later = [torch.zeros_like(whole.r[:, group[0].rows]) for _ in range(2)]
            for k in reversed(range(len(group))):
                piece = group[k]
                at = starts[:, piece.rows, k : k + 1]
                gradients = _through(piece, whole, at, given, later, wanted)
                into = piece.of(found, *(x.zero_() for x in later))
                for x, gradient in zip(into, gradients, strict=True):
                    if gradient is not None:
                        x.add_(gradient)
            found.r[:, group[0].rows], found.v[:, group[0].rows] = later
        return tuple(found)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        """Keep nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        raise NotImplementedError(
            "strapdown_over_time: gradient='recompute' is differentiable once; for second "
            "derivatives choose gradient='tape'"
        )

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
        return _apply_batched(_Adjoint, info.batch_size, in_dims, inputs)


def _through(
    piece: Piece,
    whole: Chunk,
    start: Tensor,
    given: tuple[Tensor, ...],
    later: list[Tensor],
    wanted: int,
) -> list[Tensor | None]:
    """Return the cotangents of one chunk's inputs, position and velocity always among them."""
    chunk = piece.of(whole, start[:3], start[3:])
    asked = [k for k in range(len(chunk)) if k < 2 or wanted >> k & 1]
    with torch.enable_grad():
        leaves = [x.detach().requires_grad_(k in asked) for k, x in enumerate(chunk)]
        done = move_chunk(Chunk(*leaves))
        cotangents = [g[:, piece.rows, piece.part] for g in given]
        gradients = torch.autograd.grad(
            done, [leaves[k] for k in asked], [*cotangents, *later], allow_unused=True
        )
    found: list[Tensor | None] = [None] * len(chunk)
    for k, gradient in zip(asked, gradients, strict=True):
        found[k] = gradient
    return found


def _apply_batched(
    function: Any, size: int, in_dims: tuple[int | None, ...], inputs: tuple[Any, ...]
) -> tuple[Any, tuple[int, ...]]:
    """Fold a vmapped axis into the records', which stand last but one, apply, and unfold."""
    folded = []
    for value, dim in zip(inputs, in_dims, strict=True):
        if not isinstance(value, Tensor):
            folded.append(value)
            continue
        front = value.expand(size, *value.shape) if dim is None else value.movedim(dim, 0)
        folded.append(front.movedim(0, -3).flatten(-3, -2))
    outputs = function.apply(*folded)
    unfolded = tuple(x.unflatten(-2, (size, x.shape[-2] // size)).movedim(-3, 0) for x in outputs)
    return unfolded, (0,) * len(unfolded)
