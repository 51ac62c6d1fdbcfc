"""Inertia both ways, and tensors that no body can have."""

from __future__ import annotations

import numpy as np
import pytest
from event_cases import model

from cassini_bayes.balance.inertia import (
    WITH_WHEELS,
    elements_of,
    physicality,
    tensor_of,
    without_wheels,
)
from cassini_bayes.results.inertia import inertia_draws


def test_both_conventions_give_the_same_momentum() -> None:
    """I ω + Σ I_w ρ a equals (I − Σ I_w a aᵀ) ω + Σ I_w (ρ + aᵀ ω) a, whatever ω and ρ."""
    rng = np.random.default_rng(1)
    joint = model("slews")
    z = joint.space.sample(rng, 3)
    physics = joint.points(z).physics(())
    hub = without_wheels(physics, joint.spacecraft, (1, 2, 4))
    rate, spin = rng.standard_normal(3), rng.standard_normal(3)
    axes, weights = physics.wheel_axes[..., [0, 1, 3]], physics.wheel_weights[..., [0, 1, 3]]
    relative = physics.inertia_kg_m2 @ rate + weights @ spin
    inertial = np.einsum("nij,nj->ni", weights, spin + np.swapaxes(axes, -1, -2) @ rate)
    assert relative == pytest.approx(hub @ rate + inertial, rel=1e-12)
    # three nearly orthogonal wheels of 0.16 kg m2: the trace is their sum
    lost = np.trace(physics.inertia_kg_m2 - hub, axis1=-2, axis2=-1)
    inertias = physics.wheel_inertia_kg_m2[..., [0, 1, 3]]
    assert lost == pytest.approx(inertias.sum(-1), rel=1e-9)


def test_tensors_that_no_body_can_have_are_counted() -> None:
    """One negative moment in four draws, one broken triangle in four; the sentence says so."""
    good = np.diag([3.0, 4.0, 5.0])
    tensors = np.stack([good, good, np.diag([-1.0, 4.0, 2.0]), np.diag([1.0, 1.0, 3.0])])
    found = physicality(tensors)
    assert (found.not_positive, found.breaks_triangle) == (0.25, 0.5)
    assert "25.00%" in found.sentence
    assert "Every draw" in physicality(good[None]).sentence


def test_elements_and_tensor_are_inverse() -> None:
    """Six elements make the symmetric tensor they came from; fixed ones come from constants."""
    values = np.arange(12.0).reshape(2, 6)
    assert np.array_equal(elements_of(tensor_of(values)), values)
    assert tensor_of(values)[0, 2, 1] == values[0, 5]
    names = [WITH_WHEELS.format(e) for e in ("xx", "yy", "zz", "xy", "xz", "yz")]
    draws = {name: values[:, i] for i, name in enumerate(names[:-1])}
    tensor = inertia_draws(draws, {names[-1]: 7.0}, WITH_WHEELS)
    assert np.array_equal(tensor[:, 1, 2], [7.0, 7.0])
