"""Clocks of satellite systems, told as GPS seconds.

GPS seconds run without leap from 6 January 1980, 0 h UTC; a week has 604 800 of them. Galileo and
QZSS keep GPS time; BeiDou is 14 s behind ([BeiDouB1I] §3.3); GLONASS keeps UTC, which leaps
([GLONASSICD] §3.3.3).
"""

import torch
from torch import Tensor

WEEK: float = 604800.0
"""Length of a week, s."""

BEIDOU_BEHIND: float = 14.0
"""GPS time minus BeiDou time, s."""

LEAPS: list[float] = [
    46828800.0,  # 1 July 1981
    78364801.0,
    109900802.0,
    173059203.0,
    252028804.0,
    315187205.0,
    346723206.0,
    393984007.0,
    425520008.0,
    457056009.0,
    504489610.0,
    551750411.0,
    599184012.0,
    820108813.0,
    914803214.0,
    1025136015.0,
    1119744016.0,
    1167264017.0,  # 1 January 2017, the last announced
]
"""GPS seconds at which UTC fell behind by one more second."""


def half_week(difference: Tensor) -> Tensor:
    """Return a difference of seconds of week, wrapped into half a week either way.

    [ISGPS200] §20.3.3.4.3, note of table 20-IV: t − t_oe across the change of weeks.

    Args:
        difference: Difference of two times, s, shape (...).

    Returns:
        The same difference in [−302400, 302400), s, shape (...).
    """
    # numbers, for scripted code reads no constant of its own module
    return torch.remainder(difference + 302400.0, 604800.0) - 302400.0


def leap_seconds(gps_seconds: Tensor) -> Tensor:
    """Return GPS time minus UTC.

    Args:
        gps_seconds: GPS seconds since 6 January 1980, s, shape (...).

    Returns:
        Whole seconds as float64, 18 since 2017, shape (...).
    """
    leaps = torch.tensor(LEAPS, dtype=torch.float64, device=gps_seconds.device)
    return torch.searchsorted(leaps, gps_seconds, right=True).to(torch.float64)


def gps_from_utc(utc_seconds: Tensor) -> Tensor:
    """Return GPS seconds of a UTC time, which GLONASS ephemerides and receptions may carry.

    Args:
        utc_seconds: Days since 6 January 1980 times 86400 plus the seconds of the UTC day, s,
            shape (...).

    Returns:
        GPS seconds, s, shape (...).
    """
    leaps = torch.tensor(LEAPS, dtype=torch.float64, device=utc_seconds.device)
    before = torch.arange(len(LEAPS), dtype=torch.float64, device=utc_seconds.device)
    behind = torch.searchsorted(leaps - before, utc_seconds, right=True)
    return utc_seconds + behind.to(torch.float64)
