"""A drive's past as gyro-rate errors are learned from it: channels, averages, the azimuth curve."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navlearn.error_models.gyro_terms import PHYSICAL_TERMS, PRIOR_SIGMA
from navlearn.error_models.regressors import average_samples, build_regressors
from navlearn.fusion.options import EkfOptions
from navlearn.learning.azimuth_regression import AzimuthCurve, AzimuthNoise, azimuth_curve
from navlearn.navigator import NavigatorRun
from navlearn.states import RissSample


@dataclass(frozen=True, kw_only=True)
class GyroRateOptions:
    """How a gyro-rate error model is learned.

    Attributes:
        structure: Where terms come from: ``ridge`` takes ``terms``, ``fos`` and ``pci`` find
            them.
        terms: Terms of ``ridge``.
        factors: Channels and magnitudes of which ``fos`` and ``pci`` make terms.
        degree: Largest degree of a product of ``fos``.
        power: Degree of the polynomials of ``pci``.
        max_terms: Most terms of ``fos``, most cascades of ``pci``.
        false_alarm: Chance that white noise alone has a term or cascade accepted.
        structure_every: Longest time that found terms serve before others are looked for, s.
        priors: Standard deviation of coefficients before anything is learned, SI.
        other_prior: Rate error that a term without prior is expected to make, rad/s.
        average: Longest time over which channels are averaged before terms are formed, s.
        noise: What the azimuth error holds beside the terms.
        fix_variance: Factor on the variance that the filter gives what a fix told.
        seed: Seed of the cascades that ``pci`` tries.
        safeguard: Clamps inputs and limits the correction.
        output_limit: In training standard deviations of the correction.
    """

    structure: Literal["ridge", "fos", "pci"] = "ridge"
    terms: tuple[str, ...] = PHYSICAL_TERMS
    factors: tuple[str, ...] = ("yaw_rate", "abs_yaw_rate", "f_x", "f_y", "speed", "acceleration")
    degree: int = 2
    power: int = 3
    max_terms: int = 6
    false_alarm: float = 0.05
    structure_every: float = 240.0
    priors: Mapping[str, float] = field(default_factory=lambda: PRIOR_SIGMA)
    other_prior: float = 1e-3
    average: float = 0.1
    noise: AzimuthNoise = field(default_factory=AzimuthNoise)
    fix_variance: float = 0.4
    seed: int = 0
    safeguard: bool = True
    output_limit: float = 5.0


class GyroPast(NamedTuple):
    """A drive's past, as terms are formed from it.

    Attributes:
        run: The filter's run.
        filter: Its options.
        inputs: Names of the channels.
        u: Channels averaged over ``block`` samples, shape (S, m).
        block: Samples per row of ``u``.
        end: Only samples before this one exist.
    """

    run: NavigatorRun
    filter: EkfOptions
    inputs: tuple[str, ...]
    u: Tensor
    block: int
    end: int


def gyro_past(
    run: NavigatorRun, filter_options: EkfOptions, inputs: tuple[str, ...], average: float, end: int
) -> GyroPast:
    """Return a drive's past with its channels averaged.

    Args:
        run: The filter's run.
        filter_options: Its options.
        inputs: Names of the channels.
        average: Longest time over which channels are averaged, s.
        end: Only samples before this one exist.
    """
    block = max(1, int(average / float(run.samples.dt.median()) + 1e-6))
    u = averaged_channels(RissSample(*(c[:end] for c in run.samples)), inputs, block)
    return GyroPast(run, filter_options, inputs, u, block, end)


def averaged_channels(samples: RissSample, inputs: tuple[str, ...], block: int) -> Tensor:
    """Return channels averaged over blocks of samples, the last, unfinished block included.

    Args:
        samples: Intervals, shape (T,) each.
        inputs: Names of the channels.
        block: Samples per row.

    Returns:
        Shape (⌈T / block⌉, m).
    """
    missing = -samples.dt.shape[-1] % block
    if missing:
        samples = RissSample(*(torch.cat((c, c[-1:].expand(missing))) for c in samples))
    return build_regressors(average_samples(samples, block), inputs)


def at_samples(rows: Tensor, block: int, count: int) -> Tensor:
    """Return rows of averages repeated for each of their samples, shape (count, ...).

    Args:
        rows: Shape (S, ...).
        block: Samples per row.
        count: Number of samples.
    """
    return rows.repeat_interleave(block, 0)[:count]


def past_curve(past: GyroPast, values: Tensor, options: GyroRateOptions) -> AzimuthCurve:
    """Return the azimuth error of the raw gyro over a past, and terms integrated along it.

    Args:
        past: The past.
        values: Terms by row of ``past.u``, shape (S, J).
        options: Noise.
    """
    terms = at_samples(values, past.block, past.end)
    curve = azimuth_curve(past.run, past.filter, terms, past.end)
    return curve._replace(variance=curve.variance * options.fix_variance)
