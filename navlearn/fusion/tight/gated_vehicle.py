"""What every vehicle under a tightly coupled filter tells by the model of its own filter."""

from torch import nn

from navlearn.errors import ConfigError
from navlearn.filters.unscented import UnscentedOptions
from navlearn.fusion.filter_model import FilterModel
from navlearn.fusion.gate_options import GateOptions
from navlearn.fusion.ins.model import InsFilterModel
from navlearn.fusion.measurements import Rows


class GatedVehicle(nn.Module):
    """What a filter model answers of ``Vehicle``, as in :class:`navlearn.fusion.gating.Gated`.

    Attributes:
        model: The vehicle's own loosely coupled filter, ready for computation.
    """

    model: FilterModel | InsFilterModel

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the error states, in order."""
        return self.model.layout.names

    @property
    def rows(self) -> Rows:
        """Rows of what the vehicle measures of itself, fixes among them."""
        return self.model.rows

    @property
    def limits(self) -> tuple[float, ...]:
        """Largest NIS that the gate lets pass, per kind taken."""
        return self.model.limits

    @property
    def gate(self) -> GateOptions:
        """When a measurement is refused."""
        return self.model.gate

    @property
    def anchor(self) -> int | None:
        """Kind that vouches for the others: the full IMU's position of fixes, none of RISS."""
        return self.model.anchor

    @property
    def company(self) -> tuple[int, ...]:
        """Kinds that are believed together with the anchor."""
        return self.model.company

    @property
    def unscented(self) -> UnscentedOptions | None:
        """Sigma points by which the vehicle is carried and measured; None for linear models."""
        return self.model.options.unscented

    @property
    def angle_rows(self) -> tuple[int, ...]:
        """Rows that are angles: none."""
        return ()


def closed_only(feedback: str) -> None:
    """Refuse an open loop.

    Args:
        feedback: ``closed`` or ``open``.

    Raises:
        ConfigError: If it is open.
    """
    if feedback != "closed":
        raise ConfigError(
            f"filter: found feedback {feedback!r}; ranges are linear only near the car, and sigma "
            "points are drawn about the estimate, so errors are always fed back: choose feedback "
            "closed"
        )
