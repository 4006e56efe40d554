"""Which drive a log tells of, whatever was cut from it or put into it afterwards.

A part of a drive, the same drive with faults in its fixes or with another gyro have names of their
own; for whoever may not be judged on a drive they are that drive still. Times stay as they were.
"""

from typing import Final

from navlearn.logs.drive_log import LogMetadata

DRIVE: Final = "drive"
"""Key under which ``extra`` of a made log keeps the name of the drive that it was made from."""


def drive_name(metadata: LogMetadata) -> str:
    """Return the name of the drive that a log was made from; its own where it was recorded so.

    Args:
        metadata: What is known of the log.
    """
    return str(metadata.extra.get(DRIVE, metadata.name))


def of_drive(metadata: LogMetadata) -> dict[str, object]:
    """Return the entry of ``extra`` for a log that is made from another.

    Args:
        metadata: What is known of that other log.
    """
    return {DRIVE: drive_name(metadata)}
