"""Methods that are a filter with ingredients: sigma points, tuned noise, integrity of fixes.

[Ghouneem2024] adds all three to an ordinary filter at once. Here each is a section of a recipe
and a part of a method's name, so that what each is worth can be told apart: ``ukf`` in place of
``ekf``, ``+tuned``, ``+integrity``.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from navlearn.recipe.overrides import laid_over
from navlearn.recipe.tuned_spec import TunedSpec


class Ingredients(NamedTuple):
    """What a method adds to the honest filter of its kind.

    Attributes:
        unscented: Sigma points in place of a linearisation: section ``unscented``.
        tuned: The options that a tuned spec found: section ``tuned``.
        integrity: Further limits of the gate: section ``integrity``.
    """

    unscented: bool = False
    tuned: bool = False
    integrity: bool = False


INGREDIENTS: Final[dict[str, Ingredients]] = {
    "ukf": Ingredients(unscented=True),
    "ekf+tuned": Ingredients(tuned=True),
    "ekf+integrity": Ingredients(integrity=True),
    "ekf+tuned+integrity": Ingredients(tuned=True, integrity=True),
    "ukf+tuned": Ingredients(unscented=True, tuned=True),
    "ukf+integrity": Ingredients(unscented=True, integrity=True),
    "ukf+tuned+integrity": Ingredients(unscented=True, tuned=True, integrity=True),
    "ins_ukf": Ingredients(unscented=True),
    "ins_ekf+tuned": Ingredients(tuned=True),
    "ins_ukf+tuned": Ingredients(unscented=True, tuned=True),
    "tc_ukf": Ingredients(unscented=True),
}
"""Methods with ingredients, by name; every other method has none."""

TUNED_SECTIONS: Final = ("tuned", "tuned_by_grade")
"""Keys of recipes and sweeps that say what was tuned."""

_WORTH_SAYING: Final = {
    "unscented": "sigma points in place of a linearisation",
    "tuned": "the options that the recipe's tuned spec found",
    "integrity": "the limits of the recipe's integrity section on top of its gate",
}


def ingredients_of(method: str) -> Ingredients:
    """Return what a method adds to the honest filter of its kind.

    Args:
        method: Its name.
    """
    return INGREDIENTS.get(method, Ingredients())


def described(method: str) -> str:
    """Return what a method with ingredients does, in a sentence for the report.

    Args:
        method: A name of :data:`INGREDIENTS`.
    """
    base = method.split("+")[0].replace("ukf", "ekf")
    found = INGREDIENTS[method]
    said = [words for name, words in _WORTH_SAYING.items() if getattr(found, name)]
    listed = said[0] if len(said) == 1 else f"{', '.join(said[:-1])}, and {said[-1]}"
    return f"`{base}` with {listed}"


def check_ingredients(
    methods: Sequence[str],
    *,
    unscented: bool,
    tuned: Sequence[TunedSpec | None],
    integrity: bool,
) -> None:
    """Refuse methods whose ingredients are not stated, and ingredients that no method takes.

    Args:
        methods: Names of methods.
        unscented: Whether options of sigma points are stated.
        tuned: What is tuned: one per class of drives, None where nothing is.
        integrity: Whether limits are stated.

    Raises:
        ValueError: Something is missing or left over.
    """
    made = {name: ingredients_of(name) for name in methods}
    wants_tuned = [name for name, one in made.items() if one.tuned]
    wants_limits = [name for name, one in made.items() if one.integrity]
    if wants_tuned and None in tuned:
        raise ValueError(
            f"method {wants_tuned[0]!r} needs what was tuned; name a tuned spec under 'tuned' "
            "(navlearn tune makes one), or leave the method out"
        )
    for name in wants_tuned:
        sensors = "imu" if name.startswith("ins_") else "riss"
        for spec in tuned:
            if spec is not None and spec.sensors != sensors:
                raise ValueError(
                    f"method {name!r} needs a tuned spec of sensors {sensors!r}, but "
                    f"{spec.name!r} is of {spec.sensors!r}; name another, or leave the method out"
                )
    if wants_limits and not integrity:
        raise ValueError(
            f"method {wants_limits[0]!r} needs limits beyond those of the filter's gate; state "
            "them under 'integrity', such as {prediction_limit: 30.0} in metres, or leave the "
            "method out"
        )
    used = {
        "unscented": unscented and not any(one.unscented for one in made.values()),
        "tuned": any(spec is not None for spec in tuned) and not wants_tuned,
        "integrity": integrity and not wants_limits,
    }
    for section, idle in used.items():
        if idle:
            takers = [name for name, one in INGREDIENTS.items() if getattr(one, section)]
            raise ValueError(
                f"{section}: no method takes it; list one of {', '.join(takers)}, or leave the "
                "section out"
            )


def without_tuned(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a recipe's file says but for what is tuned and the methods that take it.

    Args:
        content: The file's keys and values.
    """
    kept = {key: value for key, value in content.items() if key not in TUNED_SECTIONS}
    methods = kept.get("methods")
    if isinstance(methods, list):
        rest = [one for one in methods if not isinstance(one, str) or not ingredients_of(one).tuned]
        takes = {section: False for section in ("unscented", "integrity")}
        for one in rest:
            found = ingredients_of(one)._asdict() if isinstance(one, str) else {}
            takes = {
                section: taken or found.get(section, False) for section, taken in takes.items()
            }
        kept = {key: value for key, value in kept.items() if takes.get(key, True)}
        kept["methods"] = rest or ["ekf"]
    return kept


def with_ingredients(
    overrides: Mapping[str, Any],
    method: str,
    *,
    unscented: Mapping[str, Any],
    tuned: TunedSpec | None,
    integrity: Mapping[str, Any],
) -> dict[str, Any]:
    """Return overrides of a filter's options with a method's ingredients laid over them.

    Args:
        overrides: Those that all methods share, ``filter`` or ``ins_filter`` of a recipe.
        method: Its name; one without ingredients leaves them as they are.
        unscented: Overrides of the sigma points' options.
        tuned: What was tuned, or None.
        integrity: Overrides of the gate's options.
    """
    made = ingredients_of(method)
    chosen = dict(overrides)
    if made.tuned and tuned is not None:
        chosen = tuned.laid_over(chosen)
    if made.integrity:
        chosen = laid_over(chosen, {"gate": integrity})
    if made.unscented:
        chosen = laid_over(chosen, {"unscented": unscented})
    return chosen
