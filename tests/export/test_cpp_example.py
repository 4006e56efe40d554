"""The C++ example: built against the libtorch of the Python package, same numbers as Python."""

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from navlearn.error_models.base import FittedErrorModel
from navlearn.export import export_predictor

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"


@pytest.mark.cpp
@pytest.mark.skipif(
    shutil.which("cmake") is None or shutil.which("c++") is None,
    reason="needs cmake and a C++ compiler",
)
def test_cpp_program_gives_the_numbers_of_python(
    tmp_path: Path,
    make_fitted: Callable[..., FittedErrorModel],
    make_inputs: Callable[..., Tensor],
) -> None:
    prefix = f"-DCMAKE_PREFIX_PATH={torch.utils.cmake_prefix_path}"
    build = tmp_path / "build"
    configure = ["cmake", "-S", str(EXAMPLES), "-B", str(build), "-DCMAKE_BUILD_TYPE=Release"]
    subprocess.run([*configure, prefix], check=True, capture_output=True, text=True)
    subprocess.run(["cmake", "--build", str(build)], check=True, capture_output=True, text=True)
    u = make_inputs(40, seed=8)
    rows = "\n".join(",".join(f"{value:.17g}" for value in row) for row in u.tolist())
    for kind in ("anarx", "fos", "pci"):
        fitted = make_fitted(kind=kind)
        report = export_predictor(fitted, tmp_path / f"{kind}.pt", check_inputs=make_inputs())
        program = [str(build / "predict"), str(report.path)]
        done = subprocess.run(program, input=rows, check=True, capture_output=True, text=True)
        found = np.loadtxt(done.stdout.splitlines(), delimiter=",", ndmin=2)
        expected = fitted.model(u).detach().numpy()
        np.testing.assert_allclose(found.reshape(expected.shape), expected, rtol=0.0, atol=1e-12)
        assert json.loads(done.stderr)["kind"] == kind
