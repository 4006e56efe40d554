"""One door for every drive log: ``read_log(path)``.

The path may be a descriptor, a folder or a file. Without a stated format the folder is searched
for what each format cannot do without; a raw published form is preferred to plain tables beside
it.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from navlearn.errors import ConfigError, LogError, LogNotFoundError
from navlearn.logs.assemble import Published, assemble
from navlearn.logs.descriptor import FORMAT_ALIASES, Descriptor, load_descriptor
from navlearn.logs.drive_log import DriveLog
from navlearn.logs.formats.canedge import read_canedge
from navlearn.logs.formats.comma2k19 import has_segments, read_comma2k19
from navlearn.logs.formats.csv_tables import read_csv_tables, table_file
from navlearn.logs.formats.finding import listing
from navlearn.logs.formats.kitti import oxts_folder, read_kitti
from navlearn.logs.formats.native import HEADER, load_log
from navlearn.logs.formats.navinst import read_navinst
from navlearn.logs.formats.sensorlogger import is_sensorlogger, read_sensorlogger
from navlearn.logs.formats.smartloc import is_smartloc, read_smartloc
from navlearn.logs.nearest import nearest_hint
from navlearn.logs.sensor_truth import SENSOR_TRUTH, SensorTruth, load_sensor_truth

_READERS: Final[dict[str, Callable[[Path, Descriptor], Published]]] = {
    "navinst": read_navinst,
    "canedge": read_canedge,
    "kitti": read_kitti,
    "comma2k19": read_comma2k19,
    "sensorlogger": read_sensorlogger,
    "smartloc": read_smartloc,
    "csv": read_csv_tables,
}
FORMATS: Final = (*_READERS, "native")
_DESCRIPTOR_ENDINGS: Final = (".yaml", ".yml")


def read_log(path: Path | str, *, format: str | None = None) -> DriveLog:
    """Read a drive log of any known format.

    Args:
        path: Folder or file of the log, or a descriptor (``.yaml``).
        format: One of :data:`FORMATS` (``native`` is also called ``navlearn``); or the path of a
            descriptor whose layout is applied to ``path``; recognised where left out.

    Returns:
        The drive, checked, in the package's frames and units, its time from its first sample.

    Raises:
        LogNotFoundError: The path, or a file the format needs, does not exist.
        LogError: The log cannot be used as it is, or its format is not recognised.
        ConfigError: The format is unknown, or a descriptor has a wrong entry.
        MissingExtraError: The format needs a package that is not installed.
    """
    path = Path(path)
    if not path.exists():
        raise LogNotFoundError(_missing(path))
    if path.is_file() and path.suffix.lower() in _DESCRIPTOR_ENDINGS:
        return _read_described(path, format)
    if format is not None and format.lower().endswith(_DESCRIPTOR_ENDINGS):
        descriptor, _ = load_descriptor(Path(format))
        return _read(path, descriptor)
    name = recognise_format(path) if format is None else _known_format(format)
    return _read(path, _plain(path, name))


def read_sensor_truth(path: Path | str) -> SensorTruth | None:
    """Return what a simulation knows of the gyro of a log, or None where there was none.

    Args:
        path: Folder or file of the log, or a descriptor (``.yaml``).

    Raises:
        LogError: It is there and cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() in _DESCRIPTOR_ENDINGS and path.is_file():
        descriptor, path = load_descriptor(path)
        if descriptor.format != "native":
            return None
    folder = _native_folder(path.parent if path.is_file() else path)
    if folder is None or not (folder / SENSOR_TRUTH).is_file():
        return None
    return load_sensor_truth(folder)


def recognise_format(path: Path) -> str:
    """Return the format of a log by the files that it consists of.

    Args:
        path: Folder or file of the log.

    Raises:
        LogError: No format is recognised.
    """
    if path.is_file():
        if path.suffix.lower() == ".mf4":
            return "canedge"
        if path.name == HEADER:
            return "native"
        if is_sensorlogger(path):
            return "sensorlogger"
        if is_smartloc(path):
            return "smartloc"
    elif next(path.rglob("INSPVA.mat"), None) or next(path.rglob("f_w_IMSseconds_dt.mat"), None):
        return "navinst"
    elif next(path.rglob("*.[mM][fF]4"), None):
        return "canedge"
    elif oxts_folder(path):
        return "kitti"
    elif has_segments(path):
        return "comma2k19"
    elif is_sensorlogger(path):
        return "sensorlogger"
    elif is_smartloc(path):
        return "smartloc"
    elif _native_folder(path):
        return "native"
    elif _csv_folder(path):
        return "csv"
    found = listing(path) if path.is_dir() else f"the file {path.name}"
    raise LogError(
        f"{path}: no known log format; looked for INSPVA.mat (navinst), *.MF4 (canedge), "
        "oxts/timestamps.txt (kitti), processed_log/IMU (comma2k19), Gyroscope.csv and "
        f"Location.csv (sensorlogger), *_Input.txt (smartloc), {HEADER} (native) and imu.csv, "
        f"imu.csv.gz or imu.parquet (csv); found {found}; for other layouts write a descriptor"
    )


def _read_described(path: Path, format: str | None) -> DriveLog:
    descriptor, home = load_descriptor(path)
    if format is not None and FORMAT_ALIASES.get(format, format) != descriptor.format:
        raise ConfigError(
            f"{path.name}: its format is {descriptor.format}, but format={format} was asked; "
            "leave the format out"
        )
    if not home.exists():
        raise LogNotFoundError(
            f"{path.name}: path {descriptor.path} gives {_missing(home)}; set NAVLEARN_DATA to the "
            "folder that holds the logs, or correct path"
        )
    return _read(home, descriptor)


def _read(path: Path, descriptor: Descriptor) -> DriveLog:
    if descriptor.format == "native":
        home = path.parent if path.is_file() else _native_folder(path) or path
        return load_log(home)
    if descriptor.format == "csv":
        path = path.parent if path.is_file() else path
        if descriptor.tables is None:
            path = _csv_folder(path) or path
    return assemble(_READERS[descriptor.format](path, descriptor), descriptor)


def _plain(path: Path, name: str) -> Descriptor:
    home = path.resolve()
    return Descriptor.model_validate({"name": home.stem, "format": name, "path": str(path)})


def _known_format(format: str) -> str:
    name = FORMAT_ALIASES.get(format, format)
    if name in FORMATS:
        return name
    raise ConfigError(
        f"format: unknown format {format!r}{nearest_hint(format, FORMATS)}; known are "
        f"{', '.join(FORMATS)} (or navlearn), or the path of a descriptor (.yaml)"
    )


def _native_folder(path: Path) -> Path | None:
    found = sorted(path.rglob(HEADER))
    return found[0].parent if found else None


def _csv_folder(path: Path) -> Path | None:
    folders = [path, *sorted(entry for entry in path.rglob("*") if entry.is_dir())]
    found = [folder for folder in folders if table_file(folder, "imu") is not None]
    if len(found) > 1:
        names = ", ".join(str(folder.relative_to(path)) for folder in found[:4])
        raise LogError(f"{path}: {len(found)} drives below it ({names} …); name the folder of one")
    return found[0] if found else None


def _missing(path: Path) -> str:
    parent = path.resolve().parent
    while not parent.is_dir():
        parent = parent.parent
    return f"{path}: does not exist; {parent} holds {listing(parent)}"
