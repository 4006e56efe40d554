"""Checkpoints that survive an interruption, tied to the training that wrote them.

A checkpoint carries a fingerprint of data and options: going on with others would end in
weights that no uninterrupted run could have reached.
"""

import hashlib
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from navlearn.error_models.anarx import AnarxOptions
from navlearn.errors import ConfigError, OutputExistsError
from navlearn.learning.options import TrainingOptions
from navlearn.learning.windows import Windows


def fingerprint(
    train: Windows,
    valid: Windows | None,
    options: AnarxOptions,
    training: TrainingOptions,
) -> str:
    """Return a digest of everything that decides the result, but the number of iterations."""
    digest = hashlib.sha256()
    settings = asdict(training)
    settings.pop("max_iterations")
    settings.pop("checkpoint_every")
    digest.update(repr((asdict(options), settings)).encode())
    for windows in (train, valid):
        for part in windows or ():
            if isinstance(part, torch.Tensor):
                digest.update(repr(tuple(part.shape)).encode())
                digest.update(part.detach().contiguous().numpy().tobytes())
            else:
                digest.update(repr(part).encode())
    return digest.hexdigest()


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    torch.save(content, partial)
    os.replace(partial, path)


def read_checkpoint(
    path: Path, expected: str, *, otherwise: str = "another checkpoint folder"
) -> dict[str, Any]:
    """Read a checkpoint of the same training.

    Args:
        path: File.
        expected: Fingerprint of the training that wants to go on.
        otherwise: What to do instead of going on with the same, for the message.

    Raises:
        ConfigError: It was written by another training, or is damaged.
    """
    try:
        content = torch.load(path, weights_only=True)
        found = content["fingerprint"]
    except Exception as error:
        raise ConfigError(
            f"{path}: not a readable checkpoint ({type(error).__name__}); delete it to start anew"
        ) from error
    if found != expected:
        raise ConfigError(
            f"{path}: written with other data or options (fingerprint {found[:12]}, expected "
            f"{expected[:12]}); use the same, or {otherwise}"
        )
    return dict(content)


def claim_checkpoint(folder: Path, name: str, resume: bool) -> Path:
    """Return the path of a checkpoint, refusing to overwrite one by accident.

    Args:
        folder: Folder of the checkpoints.
        name: File name.
        resume: True where an existing one is to be read.

    Raises:
        OutputExistsError: There is one, and it is not to be read.
    """
    path = folder / name
    if path.exists() and not resume:
        raise OutputExistsError(
            f"{path}: a checkpoint is there already; pass resume=True to go on from it, or "
            "choose another folder"
        )
    return path
