"""Plain tables: one CSV, compressed CSV or Parquet file per table; fixes also as NMEA or u-blox.

With a descriptor any columns, units and axes; without one the canonical names of
:mod:`navlearn.logs.columns`, where a suffix may tell another unit (``lat_deg``, ``speed_kmh``).
"""

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from navlearn.errors import ConfigError, LogError, LogNotFoundError, MissingExtraError
from navlearn.logs.assemble import Published, without_empty_fixes
from navlearn.logs.columns import TABLES
from navlearn.logs.descriptor import Descriptor
from navlearn.logs.formats.epochs import clock_from_epochs
from navlearn.logs.formats.finding import existing_file, listing
from navlearn.logs.formats.nmea import read_nmea
from navlearn.logs.formats.receiver import on_the_logs_clock, refuse_other_clock
from navlearn.logs.formats.rinex import RinexRanges, rinex_of_table
from navlearn.logs.formats.satellite_names import joined_names, satellite_names
from navlearn.logs.formats.ubx import read_ubx
from navlearn.logs.local_positions import LOCAL, geodetic_table
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.table_layout import Column, Table
from navlearn.logs.units import factor_to_si, split_suffix
from navlearn.logs.validate import TEXTS

ENDINGS: Final = (".csv", ".csv.gz", ".parquet")
RECEIVER_ENDINGS: Final = (".nmea", ".nmea.gz", ".ubx", ".ubx.gz")
"""Endings of what receivers write; for fixes alone."""

_PANDAS: Final = tuple(int(part) for part in pd.__version__.split(".")[:2])
# From 3.1 pandas reads every float64 exactly and warns of the option that older ones need.
_EXACT: Final[Any] = {} if _PANDAS >= (3, 1) else {"float_precision": "round_trip"}
STEMS: Final[dict[str, tuple[str, ...]]] = {
    "imu": ("imu",),
    "odometer": ("odometer",),
    "fixes": ("fixes", "gnss"),
    "reference": ("reference",),
    "ranges": ("ranges",),
}
"""File names, without ending, that a folder without a descriptor may use for each table."""


def read_csv_tables(folder: Path, descriptor: Descriptor) -> Published:
    """Return the tables of a drive kept as plain files.

    Args:
        folder: Folder of the files.
        descriptor: Tables to read; without ``tables``, those of the usual names.

    Returns:
        Tables in canonical columns and SI units, in the files' own axes.

    Raises:
        LogNotFoundError: A file is missing.
        LogError: A file is not readable, or a column is missing.
        ConfigError: A unit or a canonical column of the descriptor is unknown.
        MissingExtraError: A Parquet file is to be read without pyarrow.
    """
    layout = descriptor.tables or _usual_tables(folder)
    tables: dict[str, pd.DataFrame] = {}
    receiver: dict[str, object] = {}
    rinex: RinexRanges | None = None
    for name, table in layout.items():
        if name == "ranges" and table.kind == "rinex":
            rinex = rinex_of_table(folder, table)
            tables[name], receiver[name] = rinex.table, dict(rinex.notes)
        elif table.kind == "table":
            frame = _read(folder, name, table)
            tables[name] = geodetic_table(table.file, frame, descriptor.origin)
        else:
            tables[name], notes = _receivers(folder, name, table, descriptor)
            receiver[name] = dict(notes)
    for name, table in layout.items():
        if name in receiver and "imu" in tables:
            refuse_other_clock(table.file, name, tables[name], tables["imu"])
    return Published(
        tables=tables,
        files={str(name): table.file for name, table in layout.items()},
        source=f"csv: {folder}",
        interval_means=tuple(n for n, table in layout.items() if table.sampling == "interval"),
        extra={"receiver": receiver} if receiver else {},
        klobuchar=() if rinex is None else rinex.klobuchar,
        gps_time_origin=None if rinex is None else rinex.gps_time_origin,
    )


def table_file(folder: Path, table: str) -> Path | None:
    """Return the file that holds a table of a folder without a descriptor, or None.

    Args:
        folder: Folder to look in.
        table: Canonical name of the table.
    """
    for stem in STEMS[table]:
        for ending in (*ENDINGS, *(RECEIVER_ENDINGS if table == "fixes" else ())):
            if (folder / f"{stem}{ending}").is_file():
                return folder / f"{stem}{ending}"
    return None


def read_frame(path: Path) -> pd.DataFrame:
    """Return the table in a CSV, compressed CSV or Parquet file, as it stands.

    Args:
        path: File.

    Raises:
        LogError: The file is empty, truncated or not a table.
        MissingExtraError: Parquet without pyarrow.
    """
    try:
        if path.suffix == ".parquet":
            return pd.read_parquet(path)
        table: pd.DataFrame = pd.read_csv(path, low_memory=False, **_EXACT)
    except ImportError as error:
        raise MissingExtraError(
            f"{path.name}: reading Parquet needs pyarrow; pip install navlearn[parquet]"
        ) from error
    except pd.errors.EmptyDataError as error:
        raise LogError(f"{path.name}: the file is empty; a header and rows are needed") from error
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise LogError(
            f"{path.name}: not readable as a table ({error}); it is truncated or of another format"
        ) from error
    return table


def _usual_tables(folder: Path) -> dict[str, Table]:
    found = {name: table_file(folder, name) for name in TABLES}
    for name in ("imu", "fixes"):
        # Fixes can be made from a reference or from ranges; a full IMU does without an odometer.
        others = [found[other] for other in ("reference", "ranges")]
        if found[name] is None and (name == "imu" or others == [None, None]):
            stems = " or ".join(f"{stem}{ending}" for stem in STEMS[name] for ending in ENDINGS)
            raise LogNotFoundError(
                f"{folder}: no table {name} (looked for {stems}); found {listing(folder)}"
            )
    return {name: Table(file=path.name) for name, path in found.items() if path is not None}


def _read(folder: Path, name: str, layout: Table) -> pd.DataFrame:
    path = existing_file(folder, layout.file)
    frame = read_frame(path)
    if layout.columns is None:
        return _by_name(path.name, name, frame)
    result = {"t": _taken(path.name, frame, "t", layout.time)}
    for canonical, source in layout.columns.items():
        known = (*TABLES[name], *(LOCAL if "lat" in TABLES[name] else ()))
        if canonical not in known:
            hint = nearest_hint(canonical, known)
            raise ConfigError(
                f"tables.{name}.columns: {canonical} is no column of {name}{hint}; known are "
                f"{', '.join(known)}"
            )
        result[canonical] = _taken(path.name, frame, canonical, source)
    if layout.satellite is not None:
        result["satellite"] = joined_names(path.name, frame, layout.satellite)
    if layout.velocity is not None:
        speed = _taken(path.name, frame, "speed", layout.velocity.speed)
        course = _taken(path.name, frame, "course", layout.velocity.course)
        result["v_e"], result["v_n"] = speed * np.sin(course), speed * np.cos(course)
    return _on_epochs(path.name, frame, pd.DataFrame(result), layout.epoch)


def _receivers(
    folder: Path, name: str, layout: Table, descriptor: Descriptor
) -> tuple[pd.DataFrame, Mapping[str, object]]:
    if name != "fixes" or layout.kind == "rinex":
        gives = "ranges" if layout.kind == "rinex" else "fixes"
        raise ConfigError(f"tables.{name}: a receiver's file ({layout.kind}) gives {gives} alone")
    path = existing_file(folder, layout.file)
    if layout.kind == "ubx":
        found = read_ubx(path)
    else:
        found = read_nmea(path, with_separation=descriptor.geoid_height is None)
    return on_the_logs_clock(found, layout), found.notes


def _on_epochs(
    file: str, frame: pd.DataFrame, table: pd.DataFrame, epoch: Column | None
) -> pd.DataFrame:
    if epoch is None:
        return table
    table = without_empty_fixes(table.assign(epoch=_taken(file, frame, "t", epoch)))
    t, _ = clock_from_epochs(table["epoch"].to_numpy(np.float64), table["t"].to_numpy(np.float64))
    return table.assign(t=t).drop(columns="epoch")


def _taken(file: str, frame: pd.DataFrame, canonical: str, source: Column) -> pd.Series:
    if source.column not in frame:
        hint = nearest_hint(source.column, map(str, frame.columns))
        raise LogError(
            f"{file}: no column {source.column}{hint}, which the descriptor names for "
            f"{canonical}; found {', '.join(map(str, frame.columns))}"
        )
    if canonical in TEXTS:
        return satellite_names(file, frame[source.column])
    factor = source.scale * (factor_to_si(source.unit, canonical) if source.unit else 1.0)
    values = _scaled(file, frame[source.column], factor)
    return values + source.offset if source.offset != 0.0 else values


def _by_name(file: str, name: str, frame: pd.DataFrame) -> pd.DataFrame:
    known = {"t", *TABLES[name]}
    result = {}
    for found in map(str, frame.columns):
        split = None if found in known else split_suffix(found, known)
        if split is None:
            # Texts under a name of the file's own are its affair; numbers may be of use.
            if found in TEXTS:
                result[found] = satellite_names(file, frame[found])
            elif found in known or pd.api.types.is_numeric_dtype(frame[found]):
                result[found] = frame[found]
        elif split[0] in frame or split[0] in result:
            raise LogError(f"{file}: {split[0]} is there twice, also as {found}; remove one")
        else:
            factor = factor_to_si(split[1], split[0])
            result[split[0]] = _scaled(file, frame[found], factor)
    return pd.DataFrame(result)


def _scaled(file: str, values: pd.Series, factor: float) -> pd.Series:
    if pd.api.types.is_numeric_dtype(values):
        return values * factor if factor != 1.0 else values
    numeric = pd.to_numeric(values, errors="coerce")
    wrong = (numeric.isna() & values.notna()).to_numpy()
    if not wrong.any():
        return numeric * factor
    row = int(np.argmax(wrong))
    raise LogError(
        f"{file}: column {values.name} holds {values.iloc[row]!r} at row {row + 1}, expected "
        "numbers; leave a missing value empty"
    )
