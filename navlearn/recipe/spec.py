"""Model specs: what is learned; one class per kind, told apart by ``type``.

A new kind is plugged in here, and in :mod:`navlearn.experiment.methods`.
"""

from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Discriminator, Tag

from navlearn.errors import ConfigError
from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.recipe.augmented_spec import AugmentedSpec
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.recipe.ins_anarx_spec import InsAnarxSpec
from navlearn.recipe.pseudo_outage_spec import PseudoOutageSpec
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.recipe.spec_base import SafeguardSpec, SpecBase
from navlearn.recipe.strict import parse
from navlearn.recipe.yaml_file import read_yaml

KINDS: Final[dict[str, type[SpecBase]]] = {
    "anarx": AnarxSpec,
    "augmented": AugmentedSpec,
    "pseudo_outage": PseudoOutageSpec,
    "azimuth_window": AzimuthSpec,
    "ins_anarx": InsAnarxSpec,
    "range_error": RangeErrorSpec,
}
"""Class of a spec by its ``type``; a spec that tells none is ANARX's."""

_RAW: Final = SafeguardSpec(bounds=False, gate=False)

BUILT_IN: Final[dict[str, SpecBase]] = {
    spec.name: spec
    for spec in (
        AnarxSpec(name="anarx"),
        AugmentedSpec(name="augmented"),
        PseudoOutageSpec(name="pseudo_outage"),
        PseudoOutageSpec(name="ekf+fos", structure="fos"),
        PseudoOutageSpec(name="ekf+pci", structure="pci"),
        AzimuthSpec(name="iqbal2020", structure="pci", safeguard=_RAW),
        AzimuthSpec(name="iqbal2020_safe", structure="pci"),
        AzimuthSpec(name="shen2010", structure="fos", filter="shen2010", safeguard=_RAW),
        AzimuthSpec(name="shen2010_safe", structure="fos"),
        InsAnarxSpec(name="ins_ekf+anarx"),
        InsAnarxSpec(name="ins_ekf+anarx_open", training="open_loop"),
        InsAnarxSpec(name="jaradat2017", mode="paper", safeguard=_RAW),
        InsAnarxSpec(
            name="jaradat2017_closed", mode="paper", training="closed_loop", safeguard=_RAW
        ),
        InsAnarxSpec(name="jaradat2017_safe", mode="paper"),
        RangeErrorSpec(name="tc_ekf+pci", structure="pci"),
        RangeErrorSpec(name="tc_ekf+fos", structure="fos"),
        RangeErrorSpec(name="tc_ekf+anarx", structure="anarx"),
        RangeErrorSpec(name="tc_ekf+held", structure="held"),
        RangeErrorSpec(name="tc_ekf+decay", structure="decay"),
        RangeErrorSpec(name="tc_ekf+wider", structure="none"),
        RangeErrorSpec(
            name="iqbal2020_range",
            structure="pci",
            inputs=("predicted_range",),
            window_s=300.0,
            lags=10,
            degree=3,
            acceptance="paper",
            safeguard=_RAW,
        ),
    )
}
"""Models that a method's name alone calls for."""


def _kind_of(value: Any) -> Any:
    return value.get("type", "anarx") if isinstance(value, dict) else getattr(value, "type", None)


ModelSpec = Annotated[
    Annotated[AnarxSpec, Tag("anarx")]
    | Annotated[AugmentedSpec, Tag("augmented")]
    | Annotated[PseudoOutageSpec, Tag("pseudo_outage")]
    | Annotated[AzimuthSpec, Tag("azimuth_window")]
    | Annotated[InsAnarxSpec, Tag("ins_anarx")]
    | Annotated[RangeErrorSpec, Tag("range_error")],
    Discriminator(_kind_of),
]
"""Any of the specs."""


def load_spec(path: str | Path) -> ModelSpec:
    """Read a model spec.

    Args:
        path: A YAML file such as ``models/anarx.yaml``.

    Raises:
        LogNotFoundError: There is no such file.
        ConfigError: A key is unknown or a value is not allowed.
    """
    file = read_yaml(Path(path), what="model spec")
    kind = _kind_of(file.content)
    if kind not in KINDS:
        raise ConfigError(
            f"{file.where(('type',))}: type is {kind!r}; expected one of "
            f"{', '.join(KINDS)}{nearest_hint(str(kind), KINDS)}"
        )
    spec: Any = parse(KINDS[kind], file.content, file=file)
    trained = getattr(spec, "trained", None)
    if trained is not None:
        spec = spec.model_copy(update={"trained": (file.path.parent / trained).resolve()})
    made: ModelSpec = spec
    return made
