"""What a user may choose about a mechanization."""

from dataclasses import dataclass
from typing import Literal

from navlearn.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class RissOptions:
    """Choices of the reduced inertial sensor system.

    Attributes:
        dimensions: 3 uses pitch and roll and moves the height; 2 takes both as zero and holds it.
        tilt_compensation: Whether the yaw rate is divided by cos p cos r ([Shen2010] Eq. (1)
            leaves it out); None means on in 3D. In 2D there is no tilt to divide by.
        earth_rate: Whether the gyro senses the Earth rate; False for a yaw rate that is already
            relative to the ground. The transport rate goes with it.
        hold_stationary: Whether position and azimuth hold where ``stationary`` is 1.
        passes: Fixed-point passes of the parallel form, at most. ``adjoint`` stops a chunk of time
            when it has converged to 30 nm: 3 passes for minutes of driving, 10 for two days;
            ``tape`` takes them all.
        gradient: ``adjoint`` differentiates the parallel form by its hand-written adjoint
            (reverse mode, once); ``tape`` by autograd: any order and forward mode, at seven times
            the memory and a third of the speed (``python benchmarks/mechanization.py``).
    """

    dimensions: Literal[2, 3] = 3
    tilt_compensation: bool | None = None
    earth_rate: bool = True
    hold_stationary: bool = False
    passes: int = 12
    gradient: Literal["adjoint", "tape"] = "adjoint"

    def __post_init__(self) -> None:
        """Refuse what no mechanization can do.

        Raises:
            ConfigError: If an option lies outside its range.
        """
        if self.dimensions not in (2, 3):
            raise ConfigError(f"RissOptions.dimensions: found {self.dimensions!r}; choose 2 or 3")
        if self.dimensions == 2 and self.tilt_compensation:
            raise ConfigError(
                "RissOptions: found tilt_compensation with dimensions=2, where pitch and roll are "
                "zero; choose dimensions=3 or leave tilt_compensation out"
            )
        if self.passes < 1:
            raise ConfigError(f"RissOptions.passes: found {self.passes}; expected 1 or more")
        if self.gradient not in ("adjoint", "tape"):
            raise ConfigError(
                f"RissOptions.gradient: found {self.gradient!r}; choose 'adjoint' or 'tape'"
            )

    @property
    def three_d(self) -> bool:
        """Whether pitch and roll are used and height moves."""
        return self.dimensions == 3

    @property
    def compensates_tilt(self) -> bool:
        """Whether the yaw rate is divided by cos p cos r."""
        return self.three_d if self.tilt_compensation is None else self.tilt_compensation
