"""The shipped specs of gyro-rate models are the built-in ones, written out in full."""

from pathlib import Path

import pytest
import yaml

from navlearn.recipe import load_spec
from navlearn.recipe.pseudo_outage_spec import PseudoOutageSpec
from navlearn.recipe.spec import BUILT_IN
from navlearn.recipe.spec_base import SafeguardSpec

MODELS = Path(__file__).resolve().parents[2] / "models"
NAMES = ("pseudo_outage", "ekf+fos", "ekf+pci")


@pytest.mark.parametrize("name", NAMES)
def test_shipped_spec_is_the_one_that_needs_no_file(name: str) -> None:
    shipped = load_spec(MODELS / f"{name}.yaml")
    assert shipped.model_copy(update={"question": ""}) == BUILT_IN[name]


@pytest.mark.parametrize("name", NAMES)
def test_shipped_spec_writes_out_every_key(name: str) -> None:
    written = yaml.safe_load((MODELS / f"{name}.yaml").read_text(encoding="utf-8"))
    assert set(written) == set(PseudoOutageSpec.model_fields) - {"notes"}
    assert set(written["safeguard"]) == set(SafeguardSpec.model_fields)


def test_options_carry_the_spec_in_si() -> None:
    spec = PseudoOutageSpec(
        name="one", random_walk_deg_per_sqrt_h=60.0, other_prior_deg_per_s=180.0, turn_noise=0.02
    )
    options = spec.options()
    assert options.noise.gyro_random_walk == pytest.approx(0.01745329, rel=1e-6)
    assert options.other_prior == pytest.approx(3.14159265, rel=1e-8)
    assert options.noise.turn_noise == 0.02


def test_pci_takes_channels() -> None:
    with pytest.raises(ValueError, match="pci takes channels"):
        PseudoOutageSpec(name="one", structure="pci", factors=("yaw_rate", "abs_f_x"))


def test_what_no_fit_would_take_is_refused_before() -> None:
    with pytest.raises(ValueError, match="more than two factors"):
        PseudoOutageSpec(name="one", terms=("f_x*f_x*f_y",))
    with pytest.raises(ValueError, match="below 1"):
        PseudoOutageSpec(name="one", structure="pci", factors=("yaw_rate",), false_alarm=1.0)
    PseudoOutageSpec(name="one", structure="fos", false_alarm=1.0).options()
