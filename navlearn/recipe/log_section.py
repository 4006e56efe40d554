"""Where a recipe's drive is: read, simulated, spoilt, aided, or a part of a log."""

from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.fault_section import FaultSection
from navlearn.recipe.satellite_section import Satellites
from navlearn.recipe.spec_base import Positive, Seed
from navlearn.recipe.strict import Section

SCENARIO: Final = "jaradat2017"
"""Profile that is a paper's simulated scenario."""


class GyroErrorSection(Section):
    """A stated synthetic error that is added to a good gyro: semi-synthetic data.

    Attributes:
        grade: Sensor grade whose gyro error is added, such as ``mems_l``.
        seed: Seed of its draws.
    """

    grade: str
    seed: Seed = 0


class AidingSection(Section):
    """Fixes and odometer made from the log's reference: semi-real data.

    Attributes:
        grade: Sensor grade whose GNSS and odometer figures are taken, such as ``mems_m``.
        fix_rate_hz: Rate of the fixes.
        fix_noise: White noise of their position, m, in place of the grade's errors of position.
        odometer: Whether an odometer is made.
        odometer_rate_hz: Its rate.
        seed: Seed of the draws.
    """

    grade: str = "mems_m"
    fix_rate_hz: Positive = 1.0
    fix_noise: Positive | None = None
    odometer: bool = True
    odometer_rate_hz: Positive = 10.0
    seed: Seed = 0


class SimulatedSection(Section):
    """A drive that the simulator makes when the recipe is run.

    Attributes:
        profile: Kind of road; or ``jaradat2017``, the scenario of that paper's section IV, which
            has its own sensors, length and rates.
        grade: Sensor grade.
        duration_s: Length of the drive.
        imu_rate_hz: Rate of the inertial samples.
        seed: Seed of road and sensors.
        satellites: Satellites, streets and receiver that the log has raw ranges from: a preset
            such as ``suburban``, or options over one; None for a log without ranges.
    """

    profile: str = "mixed"
    grade: str = "mems_m"
    duration_s: Positive = 1800.0
    imu_rate_hz: Annotated[float, Field(gt=0, le=1000)] = 100.0
    seed: Seed = 0
    satellites: Satellites | None = None

    @model_validator(mode="after")
    def _profile_exists(self) -> "SimulatedSection":
        from navlearn.logs.synthetic.profile import PROFILES

        known = (*PROFILES, SCENARIO)
        if self.profile not in known:
            raise ValueError(
                f"unknown profile {self.profile!r}{nearest_hint(self.profile, known)}; "
                f"known: {', '.join(known)}"
            )
        if self.profile == SCENARIO:
            self._nothing_but_the_seed()
        return self

    def _nothing_but_the_seed(self) -> None:
        for name in ("grade", "duration_s", "imu_rate_hz", "satellites"):
            found = getattr(self, name)
            if found != type(self).model_fields[name].default:
                raise ValueError(
                    f"{name} is {found!r}, but profile {SCENARIO!r} has its own sensors, length "
                    "and rates; leave it out"
                )


class LogSource(Section):
    """Where the drive is: a descriptor of ``datasets/``, a path and its format, or a simulation.

    Attributes:
        descriptor: YAML descriptor of a published log.
        path: Log file or folder, for logs that need no descriptor.
        format: Reader of ``path`` (docs/logs.md lists them), or a descriptor whose layout is
            applied; recognised where left out.
        simulated: A drive to simulate.
        between_s: First and last time of the part that is used, on the log's clock; null for all.
        gyro: A synthetic error to add to the log's gyro; None leaves it as it was recorded.
        aiding: Fixes and odometer to make from the reference, for logs that have none of their
            own; None takes what the log has.
        faults: What goes wrong with the fixes, whoever made them; None leaves them as they are.
    """

    descriptor: Path | None = None
    path: Path | None = None
    format: str | None = None
    simulated: SimulatedSection | None = None
    between_s: tuple[float, float] | None = None
    gyro: GyroErrorSection | None = None
    aiding: AidingSection | None = None
    faults: FaultSection | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "LogSource":
        given = [self.descriptor, self.path, self.simulated]
        if sum(one is not None for one in given) != 1:
            raise ValueError(
                "give one of 'descriptor', 'path' (with 'format') and 'simulated', not several "
                "or none"
            )
        if self.between_s is not None and not self.between_s[0] < self.between_s[1]:
            raise ValueError(f"between_s is {list(self.between_s)}; give first and last time, s")
        if self.format is not None and self.path is None:
            raise ValueError("'format' belongs to 'path'; a descriptor names its own format")
        return self
