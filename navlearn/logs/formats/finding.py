"""Looking for files below a folder."""

from pathlib import Path

from navlearn.errors import LogNotFoundError


def listing(folder: Path, limit: int = 12) -> str:
    """Return what a folder holds, as text for a message.

    Args:
        folder: Folder to list.
        limit: Most names to give.
    """
    names = sorted(entry.name + ("/" if entry.is_dir() else "") for entry in folder.iterdir())
    if not names:
        return "nothing"
    rest = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + rest


def existing_file(folder: Path, name: str) -> Path:
    """Return the path of a file that a descriptor names.

    Args:
        folder: Folder that the name counts from.
        name: The file.

    Raises:
        LogNotFoundError: There is no such file; the message lists what is there.
    """
    path = folder / name
    if not path.is_file():
        beside = path.parent
        found = listing(beside) if beside.is_dir() else "nothing, as it does not exist"
        raise LogNotFoundError(f"{path}: no such file; the folder holds {found}")
    return path
