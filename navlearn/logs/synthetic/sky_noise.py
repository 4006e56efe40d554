"""What a filter would have to be told of simulated ranges to weigh them rightly."""

from navlearn.gnss.range_noise import RangeNoiseOptions
from navlearn.logs.synthetic.satellite_options import SatelliteOptions


def noise_of_sky(options: SatelliteOptions) -> RangeNoiseOptions:
    """Return the noise of direct signals of a simulated sky, as a filter's options.

    Deviations are those of one range: a filter that takes errors of minutes for white noise is
    still too sure of itself. Multipath is that of a standing car. Reflections, and what is
    systematic, have no place in it.

    Args:
        options: The sky.
    """
    return RangeNoiseOptions(
        orbit_clock=options.orbit,
        ionosphere=options.ionosphere,
        troposphere=options.troposphere,
        multipath=options.multipath,
        thermal=options.thermal,
        rate_floor=0.0,
        rate_multipath=0.0,
        rate_thermal=options.rate_thermal,
    )
