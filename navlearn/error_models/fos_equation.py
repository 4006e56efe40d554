"""A fitted polynomial as an equation that can be read, with the unit of each coefficient.

A coefficient has the unit of the output over those of its factors, with what cancels left out.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from navlearn.error_models.base import OUTPUT_UNITS, FittedErrorModel
from navlearn.error_models.fos_candidates import Term
from navlearn.errors import ConfigError

POWERS = {"²": 2, "³": 3, "⁴": 4}


def fitted_equation(
    fitted: FittedErrorModel, units: Mapping[str, str] | None = None, output_unit: str = ""
) -> str:
    """Return the equation of a fitted model, in the names and units that its record tells.

    Args:
        fitted: Model of FOS with its record.
        units: Units of inputs by name, for a record that names its inputs and not their units;
            unless all are there, none are written.
        output_unit: Unit of the target; empty for that of a correction to what the model
            acts on.
    """
    source, known = fitted.record.source, units or {}
    model: Any = fitted.model
    names = source.inputs if len(source.inputs) == model.inputs else ()
    told = source.input_units or tuple(known[name] for name in names if name in known)
    output = source.outputs[0] if len(source.outputs) == 1 else "y"
    unit = output_unit or OUTPUT_UNITS[source.acts_on]
    return str(model.equation(names, output, told if len(told) == model.inputs else (), unit))


def name_channels(
    inputs: int, names: tuple[str, ...], output: str, units: tuple[str, ...], output_unit: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of all channels, the output's last; see ``FosModel.equation``.

    Raises:
        ConfigError: The names or units are not as many as the inputs.
    """
    names = names or tuple(f"u{k + 1}" for k in range(inputs))
    if len(names) != inputs or len(units) not in (0, inputs):
        raise ConfigError(
            f"equation: {len(names)} names and {len(units)} units for {inputs} inputs"
        )
    return (*names, output), (*units, output_unit) if units else ()


def write_equation(
    values: Sequence[float], terms: Sequence[Term], names: Sequence[str], units: Sequence[str]
) -> str:
    """Return a sum of products as text.

    Args:
        values: Coefficients, in order.
        terms: Factors of each product as pairs of channel and lag.
        names: Names of the channels, the output last.
        units: Units of the channels, the output's last; empty to write none.
    """
    parts = []
    for value, term in zip(values, terms, strict=True):
        factors = [f"{names[c]}[k-{lag}]".replace("[k-0]", "[k]") for c, lag in term]
        unit = coefficient_unit(units[-1], [units[c] for c, _ in term]) if units else ""
        parts.append(" · ".join([f"{value:+.6g} {unit}".strip(), *factors]))
    return f"{names[-1]}[k] = " + (" ".join(parts) or "0")


def coefficient_unit(output: str, factors: Sequence[str]) -> str:
    """Return the unit of a coefficient; nothing where all cancels.

    Args:
        output: Unit of the sum, such as ``rad/s``; ``1`` or nothing for a pure number.
        factors: Units of what the coefficient is multiplied with.
    """
    powers = _powers(output)
    for unit in factors:
        powers.subtract(_powers(unit))
    above = [_atom(name, power) for name, power in powers.items() if power > 0]
    below = [_atom(name, -power) for name, power in powers.items() if power < 0]
    if not below:
        return "·".join(above)
    under = "·".join(below)
    return f"{'·'.join(above) or '1'}/{under if len(below) == 1 else f'({under})'}"


def _powers(unit: str) -> Counter[str]:
    """Return the power of each base unit; ``a/b/c`` divides by both."""
    powers: Counter[str] = Counter()
    for place, part in enumerate(unit.replace(" per ", "/").split("/")):
        for factor in part.strip(" ()").split("·"):
            power = POWERS.get(factor[-1:], 1)
            name = factor[:-1] if power > 1 else factor
            if name not in ("", "1"):
                powers[name] += power if place == 0 else -power
    return powers


def _atom(name: str, power: int) -> str:
    """Return a base unit with its power; one with a number in it in brackets."""
    shown = f"({name})" if " " in name else name
    signs = {number: sign for sign, number in POWERS.items()}
    return shown + ("" if power == 1 else signs.get(power, f"^{power}"))
