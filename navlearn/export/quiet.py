"""TorchScript announces its retirement at every call; it is silenced here and nowhere else."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_retirement_notice() -> Iterator[None]:
    """Hide the deprecation warnings of ``torch.jit``, and no others."""
    with warnings.catch_warnings():
        for category in (DeprecationWarning, FutureWarning):
            warnings.filterwarnings("ignore", message=r"`torch\.jit\.", category=category)
        yield
