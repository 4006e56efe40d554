"""Options that several commands share, and how their text is read."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.errors import ConfigError

FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="Reader of the log: navlearn, csv, navinst or canedge. A .yaml descriptor needs none.",
    ),
]
RunFolderOption = Annotated[Path, typer.Option("--out", help="Folder for the run.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="No progress bar.")]


def split_words(text: str) -> list[str]:
    """Return the words of a comma-separated option."""
    return [word.strip() for word in text.split(",") if word.strip()]


def split_numbers(text: str, *, option: str) -> list[float]:
    """Return the numbers of a comma-separated option.

    Raises:
        ConfigError: Something in the list is not a number.
    """
    try:
        return [float(word) for word in split_words(text)]
    except ValueError:
        raise ConfigError(
            f"{option} {text!r} is not understood; write seconds separated by commas, "
            "such as 700,1200.5"
        ) from None
