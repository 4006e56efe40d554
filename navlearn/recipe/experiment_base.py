"""What every recipe tells, whatever it is run on: methods, models, protocol, options."""

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, Field, model_validator

from navlearn.logs.nearest import nearest_hint
from navlearn.recipe.filter_options import (
    checked_filter,
    checked_ins_filter,
    checked_integrity,
    checked_tight,
    checked_unscented,
    ekf_options,
    ins_ekf_options,
    tight_ekf_options,
)
from navlearn.recipe.fixed_methods import (
    BASELINES,
    COMPARED_WITH,
    FIXED_METHODS,
    INS_COMPARED_WITH,
    TIGHT_COMPARED_WITH,
)
from navlearn.recipe.ingredients import check_ingredients, with_ingredients
from navlearn.recipe.sections import (
    CalibrationSection,
    MechanizationSection,
    OutageSection,
    PublishedSection,
    TrainingSection,
)
from navlearn.recipe.spec import BUILT_IN, ModelSpec
from navlearn.recipe.spec_base import PlainName, Seed
from navlearn.recipe.strict import Section
from navlearn.recipe.tuned_spec import TunedSpec

if TYPE_CHECKING:
    from navlearn.fusion.ins.options import InsEkfOptions
    from navlearn.fusion.options import EkfOptions
    from navlearn.fusion.tight.options import TightEkfOptions

VERSIONS: Final = "versions"
"""Key of a resolved recipe that is not the recipe's own."""


def _known_figure(name: str) -> str:
    from navlearn.outages.metrics import FIGURES

    if name not in FIGURES:
        raise ValueError(
            f"unknown figure {name!r}{nearest_hint(name, FIGURES)}; known: {', '.join(FIGURES)}"
        )
    return name


class Titled(Section):
    """What a recipe begins with.

    Attributes:
        name: Short name, used for files.
        question: The question that the recipe answers, in one sentence.
    """

    name: PlainName
    question: str = ""


class Experiment(Titled):
    """One experiment, but for what it is run on.

    Attributes:
        models: Specs of the error models.
        methods: What is compared: names of :data:`FIXED_METHODS`, of ``models``, and of models
            that are built in.
        mechanization: How the car is dead-reckoned.
        filter: Options of the filter that differ from their defaults, by name.
        ins_filter: The same for the filter of a full IMU.
        tight: The same for raw ranges, beside the options of the vehicle's own filter.
        unscented: Options of the sigma points of unscented filters that differ from their
            defaults, by name.
        tuned: What was tuned, for the methods with ``+tuned``.
        integrity: Options of the gate that the methods with ``+integrity`` lay over those of
            ``filter``, by name.
        outages: Where GNSS is taken away.
        training: What error models learn from.
        calibration: How late streams are stamped.
        observability: Whether the report tells what the filter observed, and when; of a full IMU
            or of one gyro as ``mechanization.sensors`` says.
        metric: Figure by which methods are compared, a column of ``outages.csv``.
        remarks: Said in the report before anything else.
        published: Tables of papers, printed beside ours.
        seed: Seed of everything that is drawn and has no seed of its own.
    """

    models: tuple[ModelSpec, ...] = ()
    methods: Annotated[tuple[str, ...], Field(min_length=1)] = BASELINES
    mechanization: MechanizationSection = MechanizationSection()
    filter: Annotated[dict[str, Any], AfterValidator(checked_filter)] = Field(default_factory=dict)
    ins_filter: Annotated[dict[str, Any], AfterValidator(checked_ins_filter)] = Field(
        default_factory=dict
    )
    tight: Annotated[dict[str, Any], AfterValidator(checked_tight)] = Field(default_factory=dict)
    unscented: Annotated[dict[str, Any], AfterValidator(checked_unscented)] = Field(
        default_factory=dict
    )
    tuned: TunedSpec | None = None
    integrity: Annotated[dict[str, Any], AfterValidator(checked_integrity)] = Field(
        default_factory=dict
    )
    outages: OutageSection = OutageSection()
    training: TrainingSection = TrainingSection()
    calibration: CalibrationSection = CalibrationSection()
    observability: bool = False
    metric: Annotated[str, AfterValidator(_known_figure)] = "max_horizontal_error_m"
    remarks: tuple[str, ...] = ()
    published: tuple[PublishedSection, ...] = ()
    seed: Seed = 0

    @model_validator(mode="before")
    @classmethod
    def _built_in_models(cls, content: Any) -> Any:
        """Add the specs of models that a method's name alone calls for."""
        if not isinstance(content, dict) or not isinstance(content.get("methods"), list | tuple):
            return content
        given = content.get("models", ())
        if not isinstance(given, list | tuple):
            return content
        names = [_name_of(one) for one in given]
        called = [spec for spec in BUILT_IN.values() if spec.name not in names]
        called = [spec for spec in called if spec.name in content["methods"]]
        return {**content, "models": [*given, *called]} if called else content

    @model_validator(mode="after")
    def _methods_exist(self) -> "Experiment":
        names = [spec.name for spec in self.models]
        for name in names:
            if name in FIXED_METHODS:
                raise ValueError(f"a model cannot be named {name!r}: that method needs no model")
            if names.count(name) > 1:
                raise ValueError(f"two models are named {name!r}; give each its own name")
        known = list(dict.fromkeys([*FIXED_METHODS, *BUILT_IN, *names]))
        for method in self.methods:
            if method not in known:
                raise ValueError(
                    f"unknown method {method!r}{nearest_hint(method, known)}; "
                    f"known: {', '.join(known)}, and the models of specs under 'models'"
                )
            if self.methods.count(method) > 1:
                raise ValueError(f"the method {method!r} is listed twice; list each once")
        return self

    @model_validator(mode="after")
    def _ingredients_are_there(self) -> "Experiment":
        check_ingredients(
            self.methods,
            unscented=bool(self.unscented),
            tuned=self.tunings,
            integrity=bool(self.integrity),
        )
        return self

    @property
    def tunings(self) -> tuple[TunedSpec | None, ...]:
        """What is tuned: one for each class of drives, None where nothing is."""
        return (self.tuned,)

    def model(self, name: str) -> ModelSpec:
        """Return the spec of a model by its name."""
        return next(spec for spec in self.models if spec.name == name)

    def ekf_options(self, method: str = "ekf") -> "EkfOptions":
        """Return the options of a method's filter: their defaults under the recipe's ``filter``.

        Args:
            method: Its ingredients are laid over what all methods share.
        """
        return ekf_options(self._with_ingredients(self.filter, method))

    def ins_ekf_options(self, method: str = "ins_ekf") -> "InsEkfOptions":
        """Return the options of a method's full-IMU filter: their defaults under ``ins_filter``.

        Args:
            method: Its ingredients are laid over what all methods share.
        """
        return ins_ekf_options(self._with_ingredients(self.ins_filter, method))

    def _with_ingredients(self, overrides: dict[str, Any], method: str) -> dict[str, Any]:
        sections = {"unscented": self.unscented, "integrity": self.integrity}
        return with_ingredients(overrides, method, tuned=self.tuned, **sections)

    def tight_ekf_options(self) -> "TightEkfOptions":
        """Return the tightly coupled filter's options: their defaults under ``tight``."""
        return tight_ekf_options(self.tight)

    @property
    def baselines(self) -> tuple[str, ...]:
        """Methods that the others are compared with, the honest filter first."""
        first = INS_COMPARED_WITH if self.mechanization.sensors == "imu" else COMPARED_WITH
        order = dict.fromkeys((*TIGHT_COMPARED_WITH, *first, *COMPARED_WITH, *INS_COMPARED_WITH))
        return tuple(name for name in order if name in self.methods)

    def resolved(self) -> dict[str, Any]:
        """Return the recipe with every default written out, and the versions that made it.

        The mapping holds plain values and absolute paths; written as YAML and loaded again it
        gives an equal recipe.
        """
        return {**self.model_dump(mode="json"), VERSIONS: _versions()}


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in ("navlearn", "torch", "numpy", "pandas", "lightning"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


def _name_of(spec: Any) -> Any:
    return spec.get("name") if isinstance(spec, dict) else getattr(spec, "name", None)
