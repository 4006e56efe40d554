"""What the filters refused over one drive of a sweep, kept in a file until all drives are there."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from navlearn.logs.drive_log import DriveLog
from navlearn.outages.detection import detection_by_kind
from navlearn.outages.refused_report import FAULTS, Refusals, by_method, refused_tables


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveRefusals:
    """What filters refused over a drive.

    Attributes:
        drive: Its name.
        files: Tables by the name of the file that they are for.
        caught: How many position fixes were caught, by method and kind of fault, as
            :func:`navlearn.outages.detection.detection_by_kind` counts them; empty where no
            faults were put in.
        lost: Why a method has nothing to tell.
    """

    drive: str
    files: Mapping[str, pd.DataFrame]
    caught: pd.DataFrame
    lost: Mapping[str, str]


def drive_refusals(found: Mapping[str, Refusals | str], log: DriveLog) -> DriveRefusals:
    """Return what filters refused over a drive, as tables.

    Args:
        found: By method; a sentence where a filter was lost.
        log: The whole drive.
    """
    whole = {name: one for name, one in found.items() if isinstance(one, Refusals)}
    drive, files = log.metadata.name, refused_tables(whole, log).files
    caught = {}
    if FAULTS in files:
        faults = files[FAULTS]
        caught = {name: detection_by_kind(one.fixes, faults) for name, one in whole.items()}
        files[FAULTS] = faults.assign(drive=drive)[["drive", *faults.columns]]
    return DriveRefusals(
        drive=drive,
        files=files,
        caught=by_method(caught, drive),
        lost={name: one for name, one in found.items() if isinstance(one, str)},
    )


def save_refusals(file: Path, found: DriveRefusals) -> None:
    """Write what filters refused over a drive; the file appears whole or not at all.

    Args:
        file: The file.
        found: What they refused.
    """
    content = {
        "drive": found.drive,
        "files": {name: table.to_dict("list") for name, table in found.files.items()},
        "caught": found.caught.to_dict("list"),
        "lost": dict(found.lost),
    }
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content) + "\n", encoding="utf-8")
    os.replace(part, file)


def read_refusals(file: Path) -> DriveRefusals:
    """Return what :func:`save_refusals` wrote, number by number.

    Args:
        file: The file.
    """
    content = json.loads(file.read_text(encoding="utf-8"))
    return DriveRefusals(
        drive=content["drive"],
        files={name: pd.DataFrame(table) for name, table in content["files"].items()},
        caught=pd.DataFrame(content["caught"]),
        lost=content["lost"],
    )
