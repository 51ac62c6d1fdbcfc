"""Inner products of some columns, band by band, are those of all of them at these places."""

import numpy as np
import pytest

from cassini_bayes.balance.band_products import BandProducts

AXES, COLUMNS, MODES = 3, 7, 12


def gram(values: np.ndarray) -> np.ndarray:
    """Inner products (3, 3, A, A), written out, of columns (3, A, m)."""
    return np.einsum("iam,jbm->ijab", values, values)


@pytest.mark.parametrize("is_whole", [True, False])
def test_bands_of_some_columns(is_whole: bool) -> None:
    """Bands of modes, what no mode has, and what stands beside them; all but that as one band.

    Control: with the slower modes left out of what they take, the last band has too much.
    """
    values = np.random.default_rng(3).standard_normal((AXES, COLUMNS, MODES))
    slower, first, second, rest = np.split(values, [2, 5, 9], axis=2)
    whole = gram(values) if is_whole else None
    other = gram(rest[:, :, :1])
    products = BandProducts(slower, (first, second), whole, (other,))
    columns = np.array([4, 0, 6])
    expected = [gram(first), gram(second), *([gram(rest)] if is_whole else []), other]
    wanted = np.array(expected)[..., columns[:, None], columns]
    assert products.of(columns) == pytest.approx(wanted)
    together = BandProducts(slower, (first, second), whole).as_one().of(columns)
    assert together == pytest.approx(wanted[:-1].sum(axis=0, keepdims=True))
    if is_whole:
        wrong = BandProducts(slower[..., :0], (first, second), whole).of(columns)
        assert np.abs(wrong[-1] - wanted[-2]).max() > 0.1
