"""Looking for files below a folder."""

from pathlib import Path


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
