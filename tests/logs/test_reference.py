import numpy as np
import pandas as pd
import pytest
import torch

from navlearn import earth
from navlearn.errors import LogError
from navlearn.logs.reference import reference_at, reference_from_fixes


def test_samples_are_met_and_columns_kept(make_log, tables):
    log = make_log()
    found = reference_at(log, torch.tensor(tables["reference"]["t"].to_numpy()))
    assert set(found) == set(tables["reference"])
    for name in found:
        np.testing.assert_allclose(found[name], tables["reference"][name], atol=1e-12)


def test_a_braking_car_is_followed_between_samples(make_log):
    """Closed form: constant deceleration northward, a cubic follows it exactly."""
    t, fine = np.arange(0.0, 11.0), np.arange(0.0, 10.0, 0.05)
    lat_0 = 0.772
    radius = float(earth.meridian_radius(torch.tensor(lat_0, dtype=torch.float64)))

    def north(at):
        return 20.0 * at - at**2

    table = pd.DataFrame({"t": t, "lat": lat_0 + north(t) / radius, "lon": -1.33, "height": 0.0})
    table = table.assign(v_n=20.0 - 2.0 * t, v_e=0.0)
    found = reference_at(make_log(reference=table), fine)
    assert np.abs((found["lat"] - lat_0) * radius - north(fine)).max() < 1e-3
    straight = reference_at(make_log(reference=table.drop(columns=["v_n", "v_e"])), fine)
    assert np.abs((straight["lat"] - lat_0) * radius - north(fine)).max() > 0.2


def test_azimuth_goes_the_short_way_round(make_log, tables):
    table = tables["reference"].assign(azimuth=np.mod(0.35 - 0.1 * np.arange(11), 2 * np.pi))
    found = reference_at(make_log(reference=table), np.array([3.25, 3.5, 3.75]))
    np.testing.assert_allclose(
        found["azimuth"], np.mod([0.025, 0.0, -0.025], 2 * np.pi), atol=1e-12
    )


def test_gaps_and_ends_are_nan(make_log, tables):
    table = tables["reference"].drop(index=[4, 5, 6])
    at = np.array([-0.5, 0.0, 3.0, 3.5, 6.5, 7.0, 10.0, 10.5])
    found = reference_at(make_log(reference=table), at)
    expected = [False, True, True, False, False, True, True, False]
    for name in ("lat", "azimuth", "v_n"):
        assert found[name].notna().tolist() == expected
    bridged = reference_at(make_log(reference=table), at, max_gap=4.0)
    assert bridged["lat"].notna().tolist() == [False, *[True] * 6, False]


def test_nan_of_one_column_stays_in_its_column(make_log, tables):
    table = tables["reference"].copy()
    table.loc[5, "azimuth"] = np.nan
    found = reference_at(make_log(reference=table), np.array([4.0, 4.5, 5.0, 5.5, 6.0]))
    assert found["azimuth"].notna().tolist() == [True, False, False, False, True]
    assert found["lat"].notna().all()


def test_without_a_reference(make_log):
    with pytest.raises(LogError, match=r"small: the log has no reference.*reference_from_fixes"):
        reference_at(make_log(reference=None), np.array([1.0]))


def test_fixes_as_reference(make_log, tables):
    fixes = tables["fixes"].copy()
    fixes["v_e"], fixes["v_n"] = -5.0, 5.0
    fixes.loc[2, ["v_e", "v_n"]] = 0.5
    fixes.loc[3, ["lat", "lon"]] = np.nan
    found = reference_from_fixes(make_log(fixes=fixes))
    assert len(found) == 10
    assert found["azimuth"].isna().sum() == 1
    assert found["azimuth"].iloc[0] == pytest.approx(np.radians(315.0))
    assert "std_e" not in found
    assert "azimuth" not in reference_from_fixes(make_log(fixes=fixes[["t", "lat", "lon"]]))
