"""What the first lines of RINEX files say, by georinex."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO

from navlearn.errors import LogError, MissingExtraError

DAMAGE: Final = (OSError, EOFError, zlib.error, UnicodeDecodeError)
"""How opening and unpacking a file fails where it is damaged."""

_MALFORMED: Final = (ValueError, KeyError, IndexError, AssertionError, TypeError)
_OWN_TIME: Final = {"R": "GLO", "E": "GAL", "J": "QZS", "C": "BDT"}


@dataclass(frozen=True, kw_only=True)
class ObservationHeader:
    """What an observation file says of its records.

    Attributes:
        version: 2 or 3.
        fields: Names of the observations, in order, by constellation; under ``*`` for all of them
            in version 2.
        time_system: ``GPS``, ``GAL``, ``QZS``, ``BDT`` or ``GLO`` (UTC).
        position: Where the antenna stood, Earth-fixed, m; empty where it does not say.
    """

    version: int
    fields: Mapping[str, Sequence[str]]
    time_system: str
    position: tuple[float, ...]

    @property
    def told(self) -> str:
        """The observations that it names, for messages."""
        return "; ".join(f"{letter} {' '.join(names)}" for letter, names in self.fields.items())


def georinex() -> Any:
    """Return the library that knows RINEX.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import georinex
    except ImportError as error:
        raise MissingExtraError(
            "reading RINEX needs georinex; pip install navlearn[gnss]"
        ) from error
    return georinex


def rinex_version(path: Path, kind: str) -> int:
    """Return the version of a RINEX file, where it is of a kind and version that is read.

    Args:
        path: File.
        kind: ``obs`` or ``nav``.

    Returns:
        2 or 3.

    Raises:
        MissingExtraError: georinex is not installed.
        LogError: It is empty, damaged, of another kind, or of another version than 2 and 3.
    """
    name = {"obs": "an observation", "nav": "a navigation"}[kind]
    try:
        info: Mapping[Any, Any] = georinex().rinexinfo(path)
    except DAMAGE as error:
        raise LogError(f"{path.name}: not readable ({error}); it is truncated") from error
    except (ValueError, TypeError, IndexError) as error:
        raise LogError(
            f"{path.name}: no RINEX file ({error}); expected {name} file of version 2 or 3"
        ) from error
    if info.get("rinextype") != kind:
        raise LogError(
            f"{path.name}: a RINEX file of type {info.get('rinextype')}; expected {name} file"
        )
    if not 2.0 <= float(info["version"]) < 4.0:
        raise LogError(
            f"{path.name}: RINEX version {info['version']}; versions 2 and 3 are read, convert it"
        )
    return int(float(info["version"]))


def observation_header(where: str, stream: TextIO, version: int) -> ObservationHeader:
    """Return the header of an observation file, which is read up to its records.

    Args:
        where: Name of the file, for messages.
        stream: The open file.
        version: 2 or 3.

    Raises:
        LogError: It cannot be read.
    """
    library = georinex()
    try:
        if version == 3:
            header = library.obs3.obsheader3(stream)
            fields = dict(header["fields"])
        else:
            header = library.obs2.obsheader2(stream)
            fields = {"*": header["fields"]}
    except _MALFORMED as error:
        raise LogError(
            f"{where}: its header cannot be read ({type(error).__name__}: {error}); it is "
            "truncated or damaged"
        ) from error
    _refuse_scaled(where, str(header.get("SYS / SCALE FACTOR", "")))
    stated = str(header.get("TIME OF FIRST OBS", ""))[48:51].strip()
    return ObservationHeader(
        version=version,
        fields=fields,
        time_system=stated or _OWN_TIME.get(str(header.get("systems")), "GPS"),
        position=tuple(header.get("position", ())),
    )


def _refuse_scaled(where: str, told: str) -> None:
    # lines of 60 columns, with a blank between them; the factor stands in columns 3 to 6
    factors = {told[start + 2 : start + 6].strip() for start in range(0, len(told), 61)}
    if factors - {"", "1"}:
        raise LogError(
            f"{where}: its observations are scaled (SYS / SCALE FACTOR: {' '.join(told.split())}); "
            "write them without factors"
        )
