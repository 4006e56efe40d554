"""Which filter a set of options asks for: extended, or unscented where it names sigma points."""

from navlearn.fusion.ins.loosely_coupled import InsEkf
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.loosely_coupled import LooselyCoupledEkf
from navlearn.fusion.options import EkfOptions
from navlearn.fusion.unscented.ins import InsUkf
from navlearn.fusion.unscented.loosely_coupled import LooselyCoupledUkf


def riss_filter(options: EkfOptions | None = None) -> LooselyCoupledEkf | LooselyCoupledUkf:
    """Return the loosely coupled filter of a RISS car.

    Args:
        options: Choices; None means the defaults.

    Raises:
        ConfigError: If the options contradict each other.
    """
    options = options or EkfOptions()
    return LooselyCoupledEkf(options) if options.unscented is None else LooselyCoupledUkf(options)


def ins_filter(options: InsEkfOptions | None = None) -> InsEkf | InsUkf:
    """Return the loosely coupled filter of a full IMU.

    Args:
        options: Choices; None means the defaults.

    Raises:
        ConfigError: If the options contradict each other.
    """
    options = options or InsEkfOptions()
    return InsEkf(options) if options.unscented is None else InsUkf(options)
