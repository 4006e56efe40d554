import warnings

import numpy as np
import pytest
import torch

from navlearn.error_models.fos_fit import fit_fos
from navlearn.error_models.fos_options import FosOptions


def frols_terms(u, y, lags, count):
    """Return the terms that SysIdentPy's forward regression chooses, as channel and lag."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    inputs = u.shape[1]
    model = FROLS(
        order_selection=False,
        n_terms=count,
        xlag=[list(range(1, lags + 2))] * inputs,
        ylag=1,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=2),
        model_type="NFIR",
    )
    # Its lags begin at 1: the target goes one row back, so that lag 1 is the row itself.
    model.fit(X=np.vstack([u, np.zeros((1, inputs))]), y=np.vstack([[[0.0]], y]))
    return [
        tuple(sorted((int(c) // 1000 - 2, int(c) % 1000 - 1) for c in row if c))
        for row in model.final_model
    ]


@pytest.mark.parametrize("correlated", [0.0, 0.9])
def test_sysidentpy_chooses_the_same_terms_in_the_same_order(correlated):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("sysidentpy")
        generator = torch.Generator().manual_seed(5)
        u = torch.randn(300, 3, generator=generator).double()
        for k in range(1, 300):
            u[k] = correlated * u[k - 1] + (1 - correlated**2) ** 0.5 * u[k]
        y = u[:, :1] - 0.6 * u[:, 1:2] * u[:, 2:] + 0.3 * u[:, 1:2].roll(2, 0) + 0.4
        y += 0.5 * torch.randn(300, 1, generator=generator).double()
        expected = frols_terms(u.numpy(), y.numpy(), lags=2, count=8)
    options = FosOptions(lags=2, max_terms=8, false_alarm=1.0)
    found = [tuple(sorted(term)) for term in fit_fos(u, y, options=options).model.terms]
    assert found == expected
