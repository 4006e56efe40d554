"""Keeps finished solutions of a replay on disk, so that an interrupted run goes on.

One file per method and outage; its name holds a hash of everything the solution depends on:
the log's samples, the outage, the method's settings, the version of navlearn.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import navlearn
from navlearn.errors import ConfigError
from navlearn.logs.drive_log import DriveLog
from navlearn.outages.schedule import Outage


class SolutionStore:
    """Solutions of one drive, one file each, found again by what they depend on."""

    def __init__(
        self,
        folder: Path,
        log: DriveLog,
        methods: Iterable[str],
        settings: Mapping[str, object] | None,
    ) -> None:
        """Open the store, making its folder.

        Args:
            folder: Where the files lie.
            log: The whole drive.
            methods: Names of the methods that will be asked for.
            settings: Per method, the plain values that it was built from.

        Raises:
            ConfigError: ``settings`` lacks a method, or holds what is not plain.
        """
        missing = [name for name in methods if name not in (settings or {})]
        if missing:
            raise ConfigError(
                f"replay: a store was given, but no settings for {missing}; without them a "
                "stored solution could outlive the options it was made with"
            )
        self._folder = folder
        self._settings = plain(settings or {}, where="settings of a replay")
        self._log = log_fingerprint(log)
        folder.mkdir(parents=True, exist_ok=True)

    def load(self, method: str, outage: Outage) -> tuple[pd.DataFrame, dict[str, object]] | None:
        """Return table and notes of a stored solution, or None.

        Args:
            method: Name of the method.
            outage: The outage.
        """
        path = self._path(method, outage)
        if not path.exists():
            return None
        with np.load(path, allow_pickle=False) as stored:
            table = pd.DataFrame({name[2:]: stored[name] for name in stored if name[:2] == "c_"})
            notes: dict[str, object] = json.loads(str(stored["notes"]))
        return table, notes

    def save(
        self, method: str, outage: Outage, table: pd.DataFrame, notes: Mapping[str, object]
    ) -> None:
        """Store a solution; the file appears whole or not at all.

        Args:
            method: Name of the method.
            outage: The outage.
            table: The solution table.
            notes: Plain values.
        """
        path = self._path(method, outage)
        arrays: dict[str, Any] = {
            f"c_{name}": table[name].to_numpy(dtype=np.float64) for name in table.columns
        }
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            np.savez_compressed(file, **(arrays | {"notes": np.array(json.dumps(notes))}))
        os.replace(part, path)

    def _path(self, method: str, outage: Outage) -> Path:
        what = {
            "version": navlearn.__version__,
            "log": self._log,
            "method": method,
            "settings": self._settings[method],
            "outage": [outage.start, outage.duration, *outage.satellites_visible],
        }
        key = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:20]
        readable = re.sub(r"[^A-Za-z0-9_-]+", "_", method)
        return self._folder / f"{readable}-{outage.start:.0f}s-{key}.npz"


def log_fingerprint(log: DriveLog) -> str:
    """Return a hash of a log's samples and of what is known beside them.

    Args:
        log: The drive.
    """
    digest = hashlib.sha256(repr(log.metadata).encode())
    for name, table in log.tables().items():
        digest.update(f"{name}:{list(table.columns)}:{len(table)}".encode())
        digest.update(pd.util.hash_pandas_object(table, index=False).to_numpy().tobytes())
    return digest.hexdigest()


def plain(values: Mapping[str, object], *, where: str) -> dict[str, object]:
    """Return values as they come back from JSON, so that fresh and stored ones are alike.

    Args:
        values: Numbers, texts, booleans, None, lists and mappings of them; NumPy scalars too.
        where: Whose they are, for the message.

    Raises:
        ConfigError: A value is of another kind.
    """
    try:
        back: dict[str, object] = json.loads(json.dumps(dict(values), default=_from_numpy))
    except TypeError as error:
        raise ConfigError(
            f"{where}: {error}; keep numbers, texts, booleans, lists and mappings only"
        ) from error
    return back


def _from_numpy(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"a value of type {type(value).__name__} is not plain")
