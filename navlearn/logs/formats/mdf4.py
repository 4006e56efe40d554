"""Is an MDF4 file whole? Its chain of blocks tells, before anything is decoded.

ASAM MDF 4: an identification of 64 bytes, then the header block; the header links to the first
data group, each data group to the next and to its data. A block starts with its name (4 bytes),
4 spare bytes, its length and the number of its links (8 bytes each), then the links.
"""

import struct
from pathlib import Path
from typing import BinaryIO, Final

from navlearn.errors import LogError

_IDENTIFICATION: Final = 64
_NEXT_GROUP, _DATA = 0, 2


def refuse_truncated(path: Path) -> None:
    """Refuse a file whose blocks do not lie wholly inside it.

    Args:
        path: MDF4 file.

    Raises:
        LogError: It is not MDF4, or its end is missing.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(16)
        if not (start.startswith(b"MDF     4") or start.startswith(b"UnFinMF 4")):
            raise LogError(f"{path.name}: does not begin as MDF4 does; it is of another make")
        links = _block(path, stream, _IDENTIFICATION, size)
        visited = set()
        while place := links[_NEXT_GROUP] if links else 0:
            if place in visited:
                raise LogError(f"{path.name}: its data groups form a circle; it is damaged")
            visited.add(place)
            links = _block(path, stream, place, size)
            if len(links) > _DATA and links[_DATA]:
                _block(path, stream, links[_DATA], size)


def _block(path: Path, stream: BinaryIO, place: int, size: int) -> tuple[int, ...]:
    stream.seek(place)
    head = stream.read(24)
    if len(head) == 24 and head.startswith(b"##"):
        length, count = struct.unpack("<QQ", head[8:])
        if place + length <= size and 24 + 8 * count <= length:
            return struct.unpack(f"<{count}Q", stream.read(8 * count))
    raise LogError(
        f"{path.name}: the block at byte {place} is not whole in {size} bytes; the file is "
        "truncated or damaged: fetch it again"
    )
