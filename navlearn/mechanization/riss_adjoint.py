"""The parallel integration of motion as one differentiable operation, adjoint by hand.

Time is cut into chunks that fit the cache, which also converge in fewer passes; the state is
carried from chunk to chunk, and the adjoint runs the chunks backwards. Seven channels are kept for
the backward pass, where autograd's tape keeps some sixty.
"""

from typing import Any

import torch
from torch import Tensor

from navlearn.mechanization.motion import RissMotion
from navlearn.mechanization.riss_chunk import adjoint_chunk, move_chunk
from navlearn.states import NavState, Trajectory

CHUNK_ELEMENTS = 16384
"""Samples of all records together in one chunk: some ten channels of it fit a level-2 cache."""


def integrate(start: NavState, motion: RissMotion, earth_rate: float, passes: int) -> Trajectory:
    """Integrate motion from a start, all samples at once; reverse mode by the adjoint.

    Args:
        start: State before the first interval, shape (...) each.
        motion: Motion, shape (..., T) each.
        earth_rate: Rotation rate of the Earth, rad/s, or zero.
        passes: Fixed-point passes per chunk, at most.

    Returns:
        Trajectory, shape (..., T) each.
    """
    shape = motion.dt.shape
    flat = [x.expand(shape[:-1]).reshape(-1) for x in start]
    channels = [x.expand(shape).reshape(shape[:-1].numel(), shape[-1]) for x in motion]
    outputs = _Integrate.apply(*flat, *channels, earth_rate, passes)  # type: ignore[no-untyped-call]
    lat, lon, height, azimuth, east, north = (x.reshape(shape) for x in outputs[:6])
    return Trajectory(lat, lon, height, azimuth, motion.v_h * east, motion.v_h * north, motion.v_u)


def _chunks(batch: int, length: int) -> list[slice]:
    size = max(CHUNK_ELEMENTS // max(batch, 1), 64)
    return [slice(k, min(k + size, length)) for k in range(0, length, size)]


class _Integrate(torch.autograd.Function):
    """(start, motion) -> (lat, lon, height, azimuth, east, north, sin φ, passes used)."""

    @staticmethod
    def forward(*inputs: Any) -> tuple[Tensor, ...]:
        *tensors, earth_rate, most_passes = inputs
        motion = RissMotion(*tensors[4:])
        whole = [torch.empty_like(motion.dt) for _ in range(7)]
        state = [x.unsqueeze(-1) for x in tensors[:4]]
        used = 1
        for part in _chunks(*motion.dt.shape):
            piece = RissMotion(*(x[:, part] for x in motion))
            moved, passes = move_chunk(state, piece, earth_rate, most_passes)
            for k in range(4):
                torch.cumsum(moved[k], -1, out=whole[k][:, part]).add_(state[k])
                state[k] = whole[k][:, part.stop - 1 : part.stop]
            for k in (4, 5, 6):
                whole[k][:, part] = moved[k]
            used = max(used, passes)
        return (*whole, torch.full_like(tensors[0], used, dtype=torch.int64))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        dt, _, v_h, v_u, ctx.earth_rate, _ = inputs[4:]
        _, _, height, _, east, north, sin_lat, used = output
        ctx.mark_non_differentiable(sin_lat, used)
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(dt, v_h, v_u, height, east, north, sin_lat, used)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor | None) -> tuple[Tensor | None, ...]:
        saved = ctx.saved_tensors
        given = [torch.zeros_like(saved[0]) if g is None else g for g in cotangents[:6]]
        found = _Adjoint.apply(*given, *saved, ctx.earth_rate)  # type: ignore[no-untyped-call]
        return (*found, None, None)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
        return _apply_batched(_Integrate, info.batch_size, in_dims, inputs)


class _Adjoint(torch.autograd.Function):
    """Cotangents of _Integrate's first six outputs, and what it saved -> those of its inputs."""

    @staticmethod
    def forward(*inputs: Any) -> tuple[Tensor, ...]:
        *tensors, earth_rate = inputs
        cotangents, saved, passes = tensors[:6], tensors[6:13], int(tensors[13].max())
        later = [torch.zeros_like(cotangents[0][:, :1]) for _ in range(4)]
        whole = [torch.empty_like(saved[0]) for _ in range(4)]
        for part in reversed(_chunks(*saved[0].shape)):
            g = [x[:, part] for x in cotangents]
            piece = [x[:, part] for x in saved]
            found = adjoint_chunk(g, later, piece, earth_rate, passes)
            for x, value in zip(whole, found, strict=True):
                x[:, part] = value
        return (*(x.squeeze(-1) for x in later), *whole)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        """Keep nothing: there is no second derivative."""

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> Any:
        raise NotImplementedError(
            "riss_over_time: the adjoint is differentiable once; for second derivatives choose "
            "RissOptions(gradient='tape')"
        )

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
        return _apply_batched(_Adjoint, info.batch_size, in_dims, inputs)


def _apply_batched(
    function: Any, size: int, in_dims: tuple[int | None, ...], inputs: tuple[Any, ...]
) -> tuple[Any, tuple[int, ...]]:
    """Fold a vmapped axis into the batch axis, apply, and unfold."""
    folded = []
    for value, dim in zip(inputs, in_dims, strict=True):
        if not isinstance(value, Tensor):
            folded.append(value)
            continue
        front = value.expand(size, *value.shape) if dim is None else value.movedim(dim, 0)
        folded.append(front.reshape(size * front.shape[1], *front.shape[2:]))
    outputs = function.apply(*folded)
    return tuple(x.reshape(size, x.shape[0] // size, *x.shape[1:]) for x in outputs), (0,) * len(
        outputs
    )
