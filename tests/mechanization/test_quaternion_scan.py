"""Prefix products by rows and by doubling against one product after another."""

import pytest
import torch

from navlearn import attitude
from navlearn.mechanization.quaternion_scan import scanned_products


@pytest.mark.parametrize(
    ("records", "count"), [(1, 1), (3, 2), (1, 700), (2, 1024), (40, 33), (5, 4500), (70, 16)]
)
def test_products_equal_the_loop(records, count):
    generator = torch.Generator().manual_seed(count)
    turn = torch.randn(records, count, 3, generator=generator, dtype=torch.float64)
    quaternion = attitude.quaternion_from_rotation_vector(turn)
    w, x, y, z = quaternion.unbind(-1)
    found = torch.stack(scanned_products((w, x, y, z)), -1)
    product = quaternion[:, 0]
    expected = [product]
    for q in quaternion[:, 1:].unbind(1):
        product = attitude.quaternion_multiply(product, q)
        expected.append(product)
    torch.testing.assert_close(found, torch.stack(expected, 1), rtol=0, atol=1e-12)
