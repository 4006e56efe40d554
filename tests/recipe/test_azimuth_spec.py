"""Specs of the papers' azimuth models, and what recipes say of papers."""

from pathlib import Path

import pytest

from navlearn.error_models.pci_options import PciOptions
from navlearn.errors import ConfigError
from navlearn.recipe import load_recipe, load_spec
from navlearn.recipe.azimuth_spec import AzimuthSpec
from navlearn.recipe.spec import BUILT_IN

ROOT = Path(__file__).resolve().parents[2]


def test_what_is_left_out_is_the_papers() -> None:
    pci = AzimuthSpec(name="a", structure="pci")
    assert (pci.window_s, pci.lags, pci.degree, pci.most) == (300.0, 10, 3, 8)
    assert pci.inputs == ("azimuth",)
    fos = AzimuthSpec(name="a", structure="fos")
    assert (fos.window_s, fos.lags, fos.degree, fos.most) == (60.0, 1, 2, 8)
    assert fos.inputs == ()
    assert AzimuthSpec(name="a", structure="pci", window_s=90.0, lags=3).window_s == 90.0
    # The models of the papers draw and accept as they do, whatever else is safe about them.
    raw = BUILT_IN["iqbal2020"]
    assert isinstance(raw, AzimuthSpec)
    assert raw.pci_options(inputs=1) == PciOptions.paper()
    assert raw.pci_options(inputs=1).safeguard is False
    assert pci.pci_options(inputs=2) == PciOptions.paper(inputs=2, safeguard=True)


def test_part_of_a_safeguard_leaves_the_rest_as_it_is() -> None:
    content = {"name": "a", "structure": "fos", "safeguard": {"gate_fewest": 8}}
    found = AzimuthSpec.model_validate(content).safeguard
    whole = AzimuthSpec(name="a", structure="fos").safeguard
    assert found == whole.model_copy(update={"gate_fewest": 8})


def test_acceptance_reaches_the_fits() -> None:
    levels = {}
    for rule in ("paper", "default", "none"):
        options = AzimuthSpec(name="a", structure="fos", acceptance=rule).fos_options()
        levels[rule] = (options.acceptance, options.false_alarm)
    assert levels["paper"][0] == "paper"
    assert levels["default"][0] == "default"
    assert levels["default"][1] < 0.5
    assert levels["none"] == ("default", 1.0)
    pci = AzimuthSpec(name="a", structure="pci", acceptance="default").pci_options(inputs=1)
    assert pci.acceptance == "default"
    assert pci.batch > 1
    with pytest.raises(ValueError, match="belongs to fos"):
        AzimuthSpec(name="a", structure="pci", acceptance="none")


@pytest.mark.parametrize("name", ["iqbal2020", "shen2010"])
def test_shipped_specs_are_the_built_in_ones_and_write_out_every_key(name: str) -> None:
    path = ROOT / "models" / f"{name}.yaml"
    shipped = load_spec(path)
    assert shipped.model_copy(update={"question": ""}) == BUILT_IN[name]
    text = path.read_text(encoding="utf-8")
    for key in set(AzimuthSpec.model_fields) - {"notes"}:
        assert f"\n{key}:" in text, key


@pytest.mark.parametrize("name", ["iqbal2020", "shen2010"])
def test_safe_versions_differ_by_their_safeguard_and_stand_beside_the_honest_filter(
    name: str,
) -> None:
    raw, safe = BUILT_IN[name], BUILT_IN[f"{name}_safe"]
    assert not raw.safeguard.gate
    assert not raw.safeguard.bounds
    assert safe.safeguard.gate
    assert safe.safeguard.bounds
    assert isinstance(safe, AzimuthSpec)
    assert safe.filter == "recipe"
    apart = {"name": raw.name, "safeguard": raw.safeguard, "filter": raw.model_dump()["filter"]}
    assert safe.model_copy(update=apart) == raw


def test_descriptions_tell_the_filter_beside() -> None:
    assert "FOS" in BUILT_IN["shen2010"].describe()
    assert "model shen2010" in BUILT_IN["shen2010"].describe()
    assert "the honest filter run feed-forward" in BUILT_IN["iqbal2020"].describe()
    assert BUILT_IN["iqbal2020"].seeds == {"iqbal2020": 0}
    assert BUILT_IN["shen2010"].seeds == {}


RECIPE = """
name: one
question: What?
log: {{path: somewhere}}
{extra}
"""


def write(tmp_path: Path, extra: str) -> Path:
    path = tmp_path / "one.yaml"
    path.write_text(RECIPE.format(extra=extra), encoding="utf-8")
    return path


def test_a_papers_table_is_read_as_printed(tmp_path: Path) -> None:
    rows = "[[KF, 78.1], [FOS, '26.31']]"
    table = f"{{source: Shen2010, caption: Mean, columns: [method, m], rows: {rows}}}"
    recipe = load_recipe(write(tmp_path, f"published: [{table}]\nmetric: rms_horizontal_error_m"))
    (found,) = recipe.published
    assert found.table().rows == (("KF", 78.1), ("FOS", "26.31"))
    assert recipe.metric == "rms_horizontal_error_m"
    wrong = table.replace("[KF, 78.1]", "[KF]")
    with pytest.raises(ConfigError, match=r"published\[0\].*row 1 has 1 cells"):
        load_recipe(write(tmp_path, f"published: [{wrong}]"))
    with pytest.raises(ConfigError, match="did you mean 'rms_horizontal_error_m'"):
        load_recipe(write(tmp_path, "metric: rms_horizontal_eror_m"))
