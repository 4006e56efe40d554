"""Methods that need no spec: baselines, smoothing, and oracles."""

from typing import Final, NamedTuple


class FixedMethod(NamedTuple):
    """What a report says of a method.

    Attributes:
        description: What it does, in a sentence.
        regime: ``none`` (nothing is trained), ``post-processing`` (sees fixes after the outage)
            or ``oracle`` (knows what no method can know).
    """

    description: str
    regime: str = "none"


FIXED_METHODS: Final[dict[str, FixedMethod]] = {
    "dead_reckoning": FixedMethod(
        "last fix, last course, bias of the last two minutes; then mechanization"
    ),
    "ekf_plain": FixedMethod(
        "the filter without a gyro bias state, what papers often compare with"
    ),
    "ekf_shen2010": FixedMethod(
        "the filter with the error states of [Shen2010] as printed, that paper's own baseline"
    ),
    "ekf": FixedMethod(
        "the honest filter: position, azimuth, gyro bias, odometer scale; tuned, gated"
    ),
    "rts": FixedMethod(
        "the honest filter smoothed from the fixes before the outage and for 120 s after it",
        "post-processing",
    ),
    "oracle": FixedMethod(
        "the filter on a gyro whose deterministic errors are taken off, told how noisy it then is",
        "oracle",
    ),
    "noise_free_gyro": FixedMethod(
        "the filter on an error-free gyro, told that it has no error", "oracle"
    ),
    "perfect_azimuth": FixedMethod("the reference's azimuth with the filter's odometer", "oracle"),
}

BASELINES: Final = ("dead_reckoning", "ekf_plain", "ekf")
"""Methods that learn nothing and know nothing but the past."""
