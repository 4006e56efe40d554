"""The folder of a run: what navlearn wrote there, and nothing else, may be replaced.

A marker file lists every file of the run before it is written and says whether the run was
finished. A folder without a marker belongs to somebody else.
"""

import json
import os
from pathlib import Path, PurePosixPath

from navlearn.errors import OutputExistsError

MARKER = ".navlearn-run.json"


class OutputFolder:
    """A run's folder; every file in it is claimed before it is written."""

    def __init__(self, path: Path) -> None:
        """Use a folder that :func:`prepare_output_folder` has prepared.

        Args:
            path: The folder.
        """
        self.path = path

    def claim(self, name: str) -> Path:
        """Return the path of a file that the run is about to write.

        Args:
            name: Path inside the folder; a name that ends with ``/`` claims a folder, whose
                files then are the run's.

        Raises:
            OutputExistsError: Somebody else's file has that name, or it leads out of the folder.
        """
        pure = PurePosixPath(name)
        path = self.path / pure
        if pure.is_absolute() or ".." in pure.parts:
            raise OutputExistsError(f"{name}: leads out of {self.path}; claim files inside it")
        claimed, finished = _read_marker(self.path)
        if name not in claimed:
            if path.exists():
                raise OutputExistsError(
                    f"{path}: exists, but no navlearn run wrote it; move it away or choose "
                    "another folder"
                )
            _write_marker(self.path, [*claimed, name], finished)
        (path if name.endswith("/") else path.parent).mkdir(parents=True, exist_ok=True)
        return path

    def finish(self) -> None:
        """Note that the run is complete: from now on it is only replaced by force."""
        claimed, _ = _read_marker(self.path)
        _write_marker(self.path, claimed, finished=True)


def prepare_output_folder(path: Path, force: bool = False) -> OutputFolder:
    """Make a folder ready for a run.

    A folder that does not exist or is empty is taken. A run that was interrupted there may go
    on. A finished run is replaced only by force: exactly the files that it wrote are removed.

    Args:
        path: The folder.
        force: Replace a finished run, or start an interrupted one afresh.

    Raises:
        OutputExistsError: The folder holds a finished run and force is off, or it holds files
            but no run, or it is a file. Nothing was changed.
    """
    if path.exists() and not path.is_dir():
        raise OutputExistsError(f"{path}: is a file; name a folder")
    if not (path / MARKER).exists():
        if path.exists() and any(path.iterdir()):
            raise OutputExistsError(
                f"{path}: holds files that no navlearn run wrote; name an empty or new folder "
                "(force replaces navlearn's own runs only)"
            )
        path.mkdir(parents=True, exist_ok=True)
        _write_marker(path, [], finished=False)
        return OutputFolder(path)
    claimed, finished = _read_marker(path)
    if finished and not force:
        raise OutputExistsError(
            f"{path}: holds a finished run; name another folder or replace it with --force"
        )
    if force:
        for name in claimed:
            _remove(path, name)
        _write_marker(path, [], finished=False)
    return OutputFolder(path)


def _remove(folder: Path, name: str) -> None:
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise OutputExistsError(f"{folder / MARKER}: lists {name}, which is not in the folder")
    if name.endswith("/"):
        files = list(path.iterdir()) if path.is_dir() else []
        for file in files:
            if file.is_file():
                file.unlink()
        # Else the empty folder would look like somebody else's when it is claimed again.
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()
    else:
        path.unlink(missing_ok=True)


def _read_marker(folder: Path) -> tuple[list[str], bool]:
    try:
        content = json.loads((folder / MARKER).read_text(encoding="utf-8"))
        return [str(name) for name in content["files"]], bool(content["finished"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OutputExistsError(
            f"{folder / MARKER}: cannot be read as the marker of a run ({error}); choose another "
            "folder"
        ) from error


def _write_marker(folder: Path, files: list[str], finished: bool) -> None:
    part = folder / (MARKER + ".part")
    part.write_text(json.dumps({"files": files, "finished": finished}, indent=1), encoding="utf-8")
    os.replace(part, folder / MARKER)
