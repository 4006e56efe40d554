"""The prediction of the full-IMU filter sample by sample, as a module that scripts.

What runs on a car's computer at the rate of the IMU. Updates come a hundred times more seldom and
stay with :meth:`navlearn.fusion.ins.loosely_coupled.InsEkf.update`.
"""

from torch import Tensor, nn

from navlearn.errors import ConfigError
from navlearn.filters.ins_belief import InsBelief
from navlearn.fusion.ins.imu_errors import SensorStates
from navlearn.fusion.ins.layout import ins_layout
from navlearn.fusion.ins.noise import (
    InsNoise,
    ins_noise_from_log,
    log_ins_noise,
    walks,
    white_noise,
)
from navlearn.fusion.ins.options import InsEkfOptions
from navlearn.fusion.ins.sample_step import sample_step
from navlearn.states import ImuSample


class InsPredictor(nn.Module):
    """One prediction per sample; holds no state, scripts, batches."""

    walks: Tensor
    white: Tensor

    def __init__(self, options: InsEkfOptions, noise: InsNoise | None = None) -> None:
        """Make choices and noise ready.

        Args:
            options: Choices of the filter.
            noise: Noise densities, learned ones say; None takes those of the options.

        Raises:
            ConfigError: If the options ask for sigma points.
        """
        super().__init__()
        if options.unscented is not None:
            raise ConfigError(
                "InsPredictor: found options.unscented; this is the extended filter's prediction: "
                "leave unscented out, or take the step of InsUkf"
            )
        layout = ins_layout(options)
        noise = ins_noise_from_log(log_ins_noise(options.noise)) if noise is None else noise
        self.has_bias: bool = layout.has_bias
        self.has_scale: bool = layout.has_scale
        self.odometer_scale: bool = layout.odometer_scale
        self.simple: bool = options.model == "dahmane2022"
        self.tau: float = options.correlation_time
        self.register_buffer("walks", walks(layout, noise).detach())
        self.register_buffer("white", white_noise(noise).detach())

    def forward(self, belief: InsBelief, sample: ImuSample) -> InsBelief:
        """Return the belief after one interval.

        Args:
            belief: Belief before it, batch shape (...).
            sample: The sample, shape (...) each.

        Returns:
            Belief after it.
        """
        # scripting keeps no named tuple among a module's attributes
        has = SensorStates(self.has_bias, self.has_scale, self.odometer_scale)
        after = sample_step(belief, sample, has, self.simple, self.tau, self.white, self.walks)
        return after[0]
