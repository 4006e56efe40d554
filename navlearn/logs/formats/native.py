"""navlearn's own form: a folder with one file per table and ``log.json`` beside them.

Reading gives back exactly what was written, to the last bit of every float64.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, Literal

import pandas as pd
from pydantic import TypeAdapter, ValidationError

from navlearn.errors import LogError, LogNotFoundError, MissingExtraError, OutputExistsError
from navlearn.logs.columns import TABLES
from navlearn.logs.drive_log import DriveLog, LogMetadata
from navlearn.logs.formats.csv_tables import read_frame
from navlearn.logs.formats.finding import listing
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.range_truth import RANGE_TRUTH, RangeTruth, save_range_truth
from navlearn.logs.sensor_truth import SENSOR_TRUTH, SensorTruth, save_sensor_truth
from navlearn.logs.validate import validate_log

HEADER: Final = "log.json"
VERSION: Final = 1
_ENDINGS: Final = {"csv": ".csv.gz", "parquet": ".parquet"}


def save_log(
    log: DriveLog,
    folder: Path | str,
    *,
    table_format: Literal["csv", "parquet"] = "csv",
    force: bool = False,
    truth: SensorTruth | None = None,
    range_truth: RangeTruth | None = None,
) -> Path:
    """Write a drive log into a folder.

    Args:
        log: Drive to write.
        folder: Folder, made where it does not exist.
        table_format: ``csv`` (compressed) or ``parquet``, which needs pyarrow.
        force: Whether an earlier log in the folder may be replaced.
        truth: What only a simulation knows of the log's gyro; written beside the tables, and
            read by oracles alone.
        range_truth: The same of the log's ranges.

    Returns:
        The folder.

    Raises:
        OutputExistsError: The folder already holds a log or one of its files.
        MissingExtraError: Parquet without pyarrow.
        LogError: The metadata hold something that JSON cannot.
    """
    folder = Path(folder)
    tables = log.tables()
    files = {name: f"{name}{_ENDINGS[table_format]}" for name in tables}
    header = _header(log, files)
    endings = _ENDINGS.values()
    beside = (HEADER, SENSOR_TRUTH, RANGE_TRUTH)
    every = (*beside, *(f"{name}{ending}" for name in TABLES for ending in endings))
    present = [name for name in every if (folder / name).exists()]
    if present and not force:
        raise OutputExistsError(
            f"{folder}: {', '.join(present)} would be overwritten; choose another folder or force"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for name in present:
        (folder / name).unlink()
    for name, table in tables.items():
        _write(table, folder / files[name])
    if truth is not None:
        save_sensor_truth(truth.of(log), folder)
    if range_truth is not None:
        save_range_truth(range_truth.of(log), folder)
    (folder / HEADER).write_text(header, encoding="utf-8")
    return folder


def load_log(folder: Path | str) -> DriveLog:
    """Read a drive log that :func:`save_log` wrote.

    Args:
        folder: Folder of the log.

    Raises:
        LogNotFoundError: The folder, its ``log.json`` or a table is missing.
        LogError: ``log.json`` or a table cannot be used.
        MissingExtraError: Parquet tables without pyarrow.
    """
    folder = Path(folder)
    if not (folder / HEADER).is_file():
        found = listing(folder) if folder.is_dir() else "no such folder"
        raise LogNotFoundError(f"{folder}: no {HEADER}; found {found}")
    header = _read_header(folder / HEADER)
    tables = {}
    for name, file in header["tables"].items():
        if not (folder / file).is_file():
            raise LogNotFoundError(
                f"{folder}: no {file}, which {HEADER} names; found {listing(folder)}"
            )
        tables[name] = read_frame(folder / file)
    return validate_log(
        DriveLog(
            imu=tables["imu"],
            odometer=tables["odometer"],
            fixes=tables["fixes"],
            reference=tables.get("reference"),
            metadata=_metadata(header["metadata"]),
            ranges=tables.get("ranges"),
        )
    )


def _header(log: DriveLog, files: dict[str, str]) -> str:
    metadata = asdict(log.metadata)
    entries = {"navlearn_log": VERSION, "tables": files, "metadata": metadata}
    try:
        return json.dumps(entries, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise LogError(
            f"{log.metadata.name}: metadata cannot be written as JSON ({error}); keep plain "
            "numbers, texts, lists and dictionaries there"
        ) from error


def _write(table: pd.DataFrame, path: Path) -> None:
    if path.suffix != ".parquet":
        # A fixed time in the gzip header: the same log gives the same bytes.
        compression = {"method": "gzip", "mtime": 0, "compresslevel": 6}
        table.to_csv(path, index=False, float_format="%.17g", compression=compression)
        return
    try:
        table.to_parquet(path, index=False)
    except ImportError as error:
        raise MissingExtraError(
            f"{path.name}: writing Parquet needs pyarrow; pip install navlearn[parquet]"
        ) from error


def _read_header(path: Path) -> dict[str, Any]:
    try:
        header = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise LogError(
            f"{path.name}: not readable as JSON ({error}); write the log again"
        ) from None
    if not isinstance(header, dict) or header.get("navlearn_log") != VERSION:
        raise LogError(f"{path.name}: expected navlearn_log: {VERSION}; it is no navlearn log")
    for key in ("tables", "metadata"):
        if not isinstance(header.get(key), dict):
            raise LogError(f"{path.name}: no {key}; write the log again")
    missing = {"imu", "odometer", "fixes"} - set(header["tables"])
    if missing:
        raise LogError(f"{path.name}: tables has no {', '.join(sorted(missing))}")
    for name, file in header["tables"].items():
        if not isinstance(file, str) or not file:
            raise LogError(f"{path.name}: tables.{name}: found {file!r}, expected a file name")
    found: dict[str, Any] = header
    return found


def _metadata(entries: dict[str, Any]) -> LogMetadata:
    known = LogMetadata.__dataclass_fields__
    for key in entries:
        if key not in known:
            raise LogError(f"{HEADER}: unknown metadata {key}{nearest_hint(key, known)}")
    try:
        return TypeAdapter(LogMetadata).validate_python(entries)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise LogError(f"{HEADER}: metadata: {where}: {first['msg']}") from None
