"""The kinds of error models that can be written to disk, and how each is rebuilt.

A kind is one entry of ``KINDS``: what beside the weights a reader needs, as plain JSON, and how
the module comes back from both.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Final

from torch import Tensor, nn

from navlearn.error_models.anarx import Anarx, AnarxOptions
from navlearn.error_models.base import FittedErrorModel
from navlearn.error_models.fos import fos_description, fos_from_description
from navlearn.error_models.pci import PciModel, PciOptions
from navlearn.error_models.pci_fit import FittedPci
from navlearn.error_models.ridge import RidgeModel, RidgeOptions
from navlearn.errors import ConfigError

Weights = dict[str, Tensor]


@dataclass(frozen=True, kw_only=True)
class StoredKind:
    """How one kind of model is described and rebuilt.

    Attributes:
        describe: Returns a module's description, plain JSON.
        rebuild: Returns the module from its description and its ``state_dict``; it carries its
            ``options``. Raises an error that is a ``ValueError`` where the two do not fit.
        fitted: Class of the fitted model.
        own: What that class has beside the fields of ``FittedErrorModel``, plain JSON.
    """

    describe: Callable[[Any], dict[str, Any]]
    rebuild: Callable[[dict[str, Any], Weights], nn.Module]
    fitted: type[FittedErrorModel] = FittedErrorModel
    own: tuple[str, ...] = ()


def _options(model: Anarx | PciModel | RidgeModel) -> dict[str, Any]:
    """Return the options, where they and the weights say all there is to say."""
    return asdict(model.options)


def _anarx(description: dict[str, Any], weights: Weights) -> nn.Module:
    model = Anarx(AnarxOptions(**description))
    load_weights(model, weights, ("variance",))
    return model


def _pci(description: dict[str, Any], weights: Weights) -> nn.Module:
    model = PciModel(PciOptions(**description))
    load_weights(model, weights, ("response", "shift", "norm", "weight", "low", "high"))
    return model


def _ridge(description: dict[str, Any], weights: Weights) -> nn.Module:
    model = RidgeModel(RidgeOptions(**description))
    load_weights(model, weights, ())
    return model


KINDS: Final[dict[str, StoredKind]] = {
    "anarx": StoredKind(describe=_options, rebuild=_anarx),
    "fos": StoredKind(describe=fos_description, rebuild=fos_from_description),
    "pci": StoredKind(describe=_options, rebuild=_pci, fitted=FittedPci, own=("tried", "cascades")),
    "ridge": StoredKind(describe=_options, rebuild=_ridge),
}
"""Every kind that can be saved; a further one is plugged in here and nowhere else."""


def load_weights(model: nn.Module, weights: Weights, free: tuple[str, ...]) -> None:
    """Copy weights into a module just built, after giving its free buffers their length.

    Args:
        model: The module.
        weights: Its ``state_dict``.
        free: Buffers whose first axis is as long as the fit made it, all of one length.

    Raises:
        ConfigError: A weight is missing, not known, or of another shape.
    """
    lengths = set()
    for name in free:
        value = weights.get(name)
        if value is None or value.shape[1:] != model.get_buffer(name).shape[1:]:
            raise ConfigError(f"{name} is missing, or of another shape than the options ask for")
        lengths.add(value.shape[0])
        setattr(model, name, value.clone())
    if len(lengths) > 1:
        raise ConfigError(f"{', '.join(free)} have the lengths {sorted(lengths)}; expected one")
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise ConfigError(str(error)) from error
