"""Kernels for another processor than this machine's: the same numbers but for rounding."""

import platform

import casadi as ca
import numpy as np
import pytest

from deltaid.errors import DeltaidError
from deltaid.kernel import target as module
from deltaid.kernel.batch import BatchKernel
from deltaid.kernel.target import VARIABLE, target

A, B = ca.SX.sym("a"), ca.SX.sym("b")


def test_code_for_another_processor_differs_by_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum of a product is rounded once or twice, by what the processor offers."""
    x = 1 + np.random.default_rng(0).uniform(size=(2, 37))
    expected = x[0] * x[1] + np.sqrt(x[0] * x[0] + x[1])
    levels = [level for level in ("x86-64-v2", "x86-64-v3", "x86-64-v4") if _usable(level)]
    assert levels or platform.machine() not in ("x86_64", "AMD64")
    for level in levels:
        monkeypatch.setenv(VARIABLE, level)
        assert target().width == (8 if level == "x86-64-v4" else 4)
        kernel = BatchKernel(ca.vertcat(A, B), A * B + ca.sqrt(A * A + B))
        np.testing.assert_allclose(kernel(x)[0], expected, rtol=4e-16)


def _usable(level: str) -> bool:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, level)
        try:
            return target().cpu == level
        except DeltaidError:
            return False


def test_a_processor_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "haswell")
    with pytest.raises(DeltaidError, match=f"{VARIABLE}: is 'haswell'.*cannot run"):
        BatchKernel(A, A + 1)


@pytest.mark.parametrize("lacking", ["fma", "bmi2"])
def test_a_processor_needs_all_that_a_level_has(
    monkeypatch: pytest.MonkeyPatch, lacking: str
) -> None:
    """Early ones have AVX2 without fused operations."""
    there = {name: name != lacking for name in ("sse4.2", "popcnt", "avx2", "fma", "bmi2")}
    monkeypatch.setattr(module.llvm, "get_host_cpu_features", lambda: there)
    monkeypatch.setattr(module, "_target", module._target.__wrapped__)  # without what it remembers
    monkeypatch.setenv(VARIABLE, "x86-64-v2")
    assert (target().cpu, target().width) == ("x86-64-v2", 4)
    monkeypatch.setenv(VARIABLE, "x86-64-v3")
    with pytest.raises(DeltaidError, match="cannot run") as caught:
        target()
    assert "use one of x86-64-v2, or unset it" in str(caught.value.cure)
