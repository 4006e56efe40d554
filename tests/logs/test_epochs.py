import numpy as np
import pytest

from navlearn.logs.formats.epochs import clock_from_epochs, rows_of_epochs


def test_messages_of_a_burst_belong_together():
    epochs = np.array([1.0, 2.0, 3.0, 4.0])
    messages = np.array([0.999, 2.002, 3.5, 4.001])
    assert rows_of_epochs(epochs, messages).tolist() == [0, 1, -1, 3]
    assert rows_of_epochs(epochs, messages[:1]).tolist() == [0, -1, -1, -1]
    assert rows_of_epochs(epochs, messages[:0]).tolist() == [-1] * 4


def test_drift_and_delay_are_found_through_jitter_and_stragglers():
    rng = np.random.default_rng(4)
    epoch = 1.6e9 + np.arange(2000.0)
    clean = (epoch - epoch[0]) * (1.0 + 80e-6) + 16.3
    arrival = clean + rng.standard_normal(2000) * 0.02
    arrival[::50] += 0.4
    t, drift = clock_from_epochs(epoch, arrival)
    assert drift == pytest.approx(80e-6, abs=3e-6)
    assert np.abs(t - clean).max() < 4e-3


def test_a_millisecond_of_print_is_rounded_away():
    epoch = np.array([0.0, 0.999, 2.001, 3.0])
    t, _ = clock_from_epochs(epoch, epoch + 5.0)
    assert np.ptp(np.diff(t)) < 2e-3


def test_two_fixes_are_shifted_by_their_median():
    t, drift = clock_from_epochs(np.array([10.0, 11.0]), np.array([1.1, 2.3]))
    np.testing.assert_allclose(t, [1.2, 2.2])
    assert drift == 0.0


def test_a_missing_epoch_row_keeps_the_others_in_place():
    epoch = np.delete(np.arange(100.0), [13, 14, 57])
    t, _ = clock_from_epochs(epoch, epoch + 2.0)
    np.testing.assert_allclose(t, epoch + 2.0, atol=1e-6)
