"""Options that several commands share, and how their text is read."""

from pathlib import Path
from typing import Annotated

import typer

from navlearn.errors import ConfigError

FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="Reader: navlearn (navlearn's own), csv, navinst, canedge, kitti, comma2k19, "
        "sensorlogger, or a descriptor (.yaml) whose layout is applied to LOG; recognised where "
        "left out.",
    ),
]
RunFolderOption = Annotated[Path, typer.Option("--out", help="Folder for the run.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
DimsOption = Annotated[
    int, typer.Option("--dims", help="Mechanization: 2 in the plane, 3 with tilt.")
]
RateOption = Annotated[float, typer.Option("--rate", help="Steps of the mechanization, Hz.")]
SensorsOption = Annotated[
    str,
    typer.Option(
        "--sensors",
        help="Of what dead_reckoning and rts are made: riss (one gyro and odometer) or imu.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of all that is drawn.")]
ModelOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--model",
        metavar="SPEC",
        help="Model spec (.yaml) of a method named in --methods; may be given repeatedly.",
    ),
]
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
