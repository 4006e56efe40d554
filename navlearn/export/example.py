"""Real inputs of a model, kept beside it in a run so that its predictor can be compared."""

from pathlib import Path

import torch
from torch import Tensor

from navlearn.errors import ConfigError, LogNotFoundError


def save_example(inputs: Tensor, path: str | Path) -> None:
    """Write inputs that a model was run on.

    Args:
        inputs: Regressors, shape (T, m).
        path: File, such as ``RUN/models/anarx_example.pt``.
    """
    torch.save({"u": inputs.detach().double().contiguous().clone()}, path)


def load_example(path: str | Path) -> Tensor:
    """Return the inputs that were kept with a model, shape (T, m).

    Args:
        path: File written by :func:`save_example`.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: The file holds something else.
    """
    path = Path(path)
    if not path.is_file():
        raise LogNotFoundError(
            f"{path}: missing; a predictor is compared with its model on the run's own data, so "
            "run the recipe again"
        )
    try:
        inputs: Tensor = torch.load(path, weights_only=True)["u"]
    except Exception as problem:
        raise ConfigError(
            f"{path}: no example inputs ({type(problem).__name__}); run the recipe again"
        ) from problem
    return inputs
