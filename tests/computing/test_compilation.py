"""Compiled functions give what they are written to give, with a cache on disk or without."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cassini_bayes.computing import compilation
from cassini_bayes.computing.compilation import compiled, compiled_sums


def summed(values: NDArray[np.float64]) -> float:
    """A loop to be compiled."""
    total = 0.0
    for value in values:
        total += value
    return total


@pytest.mark.parametrize("way", [compiled, compiled_sums])
@pytest.mark.parametrize("has_cache", [True, False])
def test_a_function_is_compiled(
    way: Callable[[Any], Any], has_cache: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sum is that of numpy; where nothing can be cached it is compiled all the same."""
    asked: list[bool] = []
    real = compilation.njit

    def njit(**options: Any) -> Any:
        asked.append(options.pop("cache", False))
        if asked[-1] and not has_cache:
            raise RuntimeError("cannot cache function: no locator available")
        return real(**options)

    monkeypatch.setattr(compilation, "njit", njit)
    found = way(summed)
    values = np.random.default_rng(1).standard_normal(1_000)
    assert found(values) == pytest.approx(values.sum(), rel=1e-12)
    assert asked == ([True] if has_cache else [True, False])
