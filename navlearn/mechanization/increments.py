"""What gyros and accelerometers measured over intervals, their errors removed."""

from torch import Tensor

from navlearn.states import ImuSample


def inertial_errors_removed(
    sample: ImuSample,
    gyro_bias: Tensor | None = None,
    accel_bias: Tensor | None = None,
    gyro_scale: Tensor | None = None,
    accel_scale: Tensor | None = None,
) -> ImuSample:
    """Return samples without the errors of their sensors: measured = (1 + scale) true + bias.

    [Groves2013] §4.4, per axis and without cross-coupling.

    Args:
        sample: Samples, shape (...) or (..., T) each, vectors with their axis last.
        gyro_bias: Gyro bias, rad/s, one per record, shape (..., 3), or per sample, (..., T, 3);
            None means zero.
        accel_bias: Accelerometer bias, m/s², shape likewise; None means zero.
        gyro_scale: Relative error of the gyros, shape likewise; None means zero.
        accel_scale: Relative error of the accelerometers, shape likewise; None means zero.

    Returns:
        Samples of the same shape.
    """
    return sample._replace(
        omega_ib_b=_removed(sample.omega_ib_b, gyro_bias, gyro_scale),
        f_b=_removed(sample.f_b, accel_bias, accel_scale),
    )


def per_sample(value: Tensor, channel: Tensor) -> Tensor:
    """Return a sensor error that broadcasts over the samples of a vector channel.

    Args:
        value: One vector per record, shape (..., 3), or per sample, (..., T, 3).
        channel: A vector channel of the record, shape (..., T, 3).

    Returns:
        Shape (..., 1, 3) or (..., T, 3).
    """
    return value.unsqueeze(-2) if value.dim() < channel.dim() else value


def _removed(measured: Tensor, bias: Tensor | None, scale: Tensor | None) -> Tensor:
    if bias is not None:
        measured = measured - per_sample(bias, measured)
    if scale is not None:
        measured = measured / (1.0 + per_sample(scale, measured))
    return measured
