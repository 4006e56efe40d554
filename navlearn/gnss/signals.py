"""Carrier frequencies, and what a delay of the ionosphere becomes on another carrier.

Source: [ISGPS200] §3.3.1, [GalileoSIS] §2.3, [BeiDouB1I] §4.1, [GLONASSICD] §3.3.1.
"""

from torch import Tensor

SPEED_OF_LIGHT: float = 299792458.0
"""Speed of light, m/s."""

L1: float = 1575.42e6
"""Carrier of GPS L1, Galileo E1, QZSS L1 and BeiDou B1C, Hz."""

B1I: float = 1561.098e6
"""Carrier of BeiDou B1I, Hz."""

G1: float = 1602.0e6
"""Carrier of GLONASS L1 at channel 0, Hz."""

G1_STEP: float = 0.5625e6
"""Distance of neighbouring GLONASS L1 channels, Hz."""


def delay_on_carrier(delay: Tensor, frequency: Tensor | float) -> Tensor:
    """Return a delay of the ionosphere on L1 as it is on another carrier.

    The delay falls with the square of the frequency, [ISGPS200] §20.3.3.5.2.5.

    Args:
        delay: Delay on L1, m, shape (...).
        frequency: Carrier, Hz, shape (...) or one number.

    Returns:
        Delay on the carrier, m, shape (...).
    """
    return delay * (L1 / frequency) ** 2
