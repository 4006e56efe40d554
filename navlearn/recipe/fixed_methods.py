"""Methods that need no spec: baselines, filters with ingredients, smoothing, and oracles."""

from typing import Final, NamedTuple

from navlearn.recipe.ingredients import INGREDIENTS, described


class FixedMethod(NamedTuple):
    """What a report says of a method.

    Attributes:
        description: What it does, in a sentence.
        regime: ``none`` (nothing is trained), ``tuned`` (on what is not judged),
            ``post-processing`` (sees fixes after the outage) or ``oracle`` (knows what no method
            can know).
    """

    description: str
    regime: str = "none"


FIXED_METHODS: Final[dict[str, FixedMethod]] = {
    "dead_reckoning": FixedMethod(
        "last fix and last known attitude or course and biases; then mechanization"
    ),
    "ekf_plain": FixedMethod(
        "the filter without a gyro bias state, what papers often compare with"
    ),
    "ekf_shen2010": FixedMethod(
        "the filter with the error states of [Shen2010] as printed, that paper's own baseline"
    ),
    "ekf_ghouneem2024": FixedMethod(
        "`ekf_shen2010` without a gate: the ordinary filter that [Ghouneem2024] starts from"
    ),
    "ekf": FixedMethod(
        "the honest filter: position, azimuth, gyro bias, odometer scale; tuned, gated"
    ),
    "ins_ekf_open_loop": FixedMethod(
        "`ins_ekf` with its errors estimated beside a free mechanization, never fed back"
    ),
    "ins_ekf_plain": FixedMethod(
        "`ins_ekf` with GNSS alone: no odometer, no non-holonomic, no standstill updates"
    ),
    "ins_ekf_dahmane2022": FixedMethod(
        "`ins_ekf_plain` with the simplified error model of [Dahmane2022], its slips repaired"
    ),
    "ins_ekf_dahmane2022_open": FixedMethod(
        "the same in open loop: the KF/INS column of that paper's tables"
    ),
    "ins_ekf": FixedMethod(
        "the honest filter of a full IMU: GNSS, odometer, non-holonomic and standstill updates"
    ),
    "tc_ekf": FixedMethod(
        "the honest filter of one gyro or a full IMU, tightly coupled: raw ranges and range rates "
        "of single satellites"
    ),
    **{
        name: FixedMethod(described(name), "tuned" if made.tuned else "none")
        for name, made in INGREDIENTS.items()
    },
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

COMPARED_WITH: Final = ("ekf", "ekf_plain")
"""Baselines that gains are counted from; the first that a recipe runs is the honest one."""

INS_COMPARED_WITH: Final = ("ins_ekf", "ins_ekf_open_loop", "ins_ekf_plain")
"""The same where ``mechanization.sensors`` is ``imu``."""

TIGHT_COMPARED_WITH: Final = ("tc_ekf",)
"""What comes before both where a recipe runs it: what is coupled tightly, without a model."""

BASELINES: Final = ("dead_reckoning", "ekf_plain", "ekf")
"""Methods that learn nothing and know nothing but the past."""
