"""Specs of range-error models: their own defaults, and what they refuse."""

from pathlib import Path

import pytest

from navlearn.errors import ConfigError
from navlearn.recipe.range_error_spec import RangeErrorSpec
from navlearn.recipe.spec import BUILT_IN, load_spec

MODELS = Path(__file__).resolve().parents[2] / "models"
NAMES = ("tc_ekf+pci", "tc_ekf+fos", "tc_ekf+anarx", "tc_ekf+held", "tc_ekf+decay")


@pytest.mark.parametrize("name", [*NAMES, "tc_ekf+wider", "iqbal2020_range"])
def test_what_is_shipped_is_what_is_built_in(name: str) -> None:
    shipped = load_spec(MODELS / f"{name}.yaml")
    assert shipped.model_copy(update={"question": ""}) == BUILT_IN[name]
    assert (MODELS / f"{name}.md").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_names_say_the_structure_and_a_safeguard_stands(name: str) -> None:
    spec = BUILT_IN[name]
    assert isinstance(spec, RangeErrorSpec)
    assert name == f"tc_ekf+{spec.structure}"
    assert spec.safeguard.gate
    assert spec.safeguard.bounds
    assert spec.regime == "online"
    assert f"{spec.window_s:g} s" in spec.describe()


def test_the_papers_model_stands_raw() -> None:
    spec = BUILT_IN["iqbal2020_range"]
    assert isinstance(spec, RangeErrorSpec)
    assert not spec.safeguard.gate
    assert not spec.safeguard.bounds
    options = spec.range_error_options().pci_options()
    assert options.acceptance == "paper"
    assert not options.safeguard
    assert not options.refit
    assert spec.seeds == {"iqbal2020_range": 0}


def test_no_model_at_all_is_a_filter_that_trusts_ranges_less() -> None:
    spec = BUILT_IN["tc_ekf+wider"]
    assert isinstance(spec, RangeErrorSpec)
    assert spec.structure == "none"
    assert "ranges as they are, each known 3 m less well" in spec.describe()
    assert BUILT_IN["tc_ekf+pci"].wider_m == 0.0  # type: ignore[union-attr]


def test_options_reach_the_model() -> None:
    spec = RangeErrorSpec.model_validate(
        {"name": "a", "structure": "fos", "inputs": ("cn0",), "lags": 3, "output_lags": 1}
    )
    options = spec.range_error_options()
    assert options.fos_options().output_lags == 1
    assert options.residual_options().inputs == ("cn0",)
    assert options.bounds
    assert RangeErrorSpec(name="b", structure="held").seeds == {}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("structure: pci\ninputs: [elevatoin]", "unknown input"),
        ("structure: pci\nmin_satellites: 3", "min_satellites"),
        ("structure: anarx\ninputs: [recent]", "feeds its own output back"),
        ("structure: kriging", "structure"),
        ("structure: pci\noutput_lags: 2", "belong to fos"),
        ("structure: pci\nwindow: 3", "window"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(f"name: a\ntype: range_error\n{content}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_spec(path)
