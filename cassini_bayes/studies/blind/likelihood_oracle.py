"""The oracle's statistics of the whole likelihood: attitudes, coarse counters, known noise.

With all causes at once, sizes s about none, the log density is to second order

    log p(u, s | y) = const + gᵀ(u, s) − ½ (u, s)ᵀ Λ (u, s),

u the baseline's coordinates. Maximised over u it is bᵀs − ½ sᵀ(1 + G) s with the prior of s, so

    G = Λ_ss − Λ_su Λ_uu⁻¹ Λ_us − 1,      b = g_s − Λ_su Λ_uu⁻¹ g_u,

which are Mᵀ V⁻¹ M and Mᵀ V⁻¹ y of :mod:`cassini_bayes.studies.blind.oracle` with a V in which
everything is that the likelihood knows of the noise. A kinked kind is taken on the side of what is
hidden.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.oscillation import Oscillation
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.sampling.warmstart import hessian
from cassini_bayes.studies.blind.oracle import KINK, KINKED, Classifier, about_null, side_of
from cassini_bayes.studies.blind.sizes import taken_up

STEP: Final = 0.2  # of the axes' lengths: rounding of 1e-6 nats is 2.5e-5 of a curvature of one
PROBE: Final = 2e-3  # prior scales, for the lengths
LONGEST: Final = {True: 0.9 * KINK / STEP, False: 1.0}
"""Prior scales of an axis, of a kinked kind (all steps stay on one side of none) and others."""


def likelihood_classifier(
    events: Events, base: Mode, hidden: Mapping[str, float], line: Oscillation | None = None
) -> Classifier:
    """Build the classifier on a flight about the baseline's mode; parameters as for the other."""
    effects, sides = [], []
    longest: list[float] = []
    for effect in events.catalogue.effects:
        if effect.needs_search and line is None:
            continue
        settled = replace(effect, search_result=line) if effect.needs_search else effect
        kinked = effect.kind.name in KINKED
        sized = [p for p in effect.parameters if p.distribution.name != "lognorm"]
        sign = float(np.sign(hidden.get(sized[0].key, 1.0))) if kinked else 0.0
        effects.append(about_null(settled, sign, hidden))
        sides.append(side_of(effect, 0.0, len(longest)))
        longest += [LONGEST[kinked]] * len(sized)
    settled_events = events.with_columns_of([effect for effect, _ in effects])
    joint = _joint(none_hypothesis(settled_events), effects)
    gram, score = _statistics(joint, base, np.array(longest), _ridges(joint, len(base.point)))
    return Classifier(gram, score, tuple(sides))


def _joint(none: Hypothesis, effects: Sequence[tuple[Effect, Sequence[float]]]) -> Hypothesis:
    """The baseline with all effects, their time constants fixed."""
    joint = extend(none, [effect for effect, _ in effects])
    fixed = {
        p.name: float(p.distribution.quantile_of_standard(at))
        for effect, rest in effects
        for p, at in zip(effect.parameters, rest, strict=True)
        if p.distribution.name == "lognorm"
    }
    old = joint.model.space
    kept = [i for i, name in enumerate(old.names) if name not in fixed]
    space = ParameterSpace(
        tuple(old.names[i] for i in kept),
        {**old.fixed, **fixed},
        tuple(old.distributions[i] for i in kept),
        tuple(old.blocks[i] for i in kept),
    )
    return compact(replace(joint, model=replace(joint.model, space=space)))


def _ridges(joint: Hypothesis, d: int) -> Array:
    """Directions (d + q, q) of sizes: one prior scale, a departure taken off its own parameter.

    The likelihood then changes by what the baseline's prior has against it, and not by thousands.
    """
    space = joint.model.space
    moves = np.zeros((len(space.names), len(space.names) - d))
    moves[d:] = np.eye(len(space.names) - d)
    of_effects = [p for effect in joint.effects for p in effect.parameters]
    added = {p.name: {p.baseline: p.distribution.scale} for p in of_effects if p.is_departure}
    for column, name in enumerate(space.names[d:]):
        moves[:, column] -= taken_up(space, added.get(name, {}))
    return moves


def _statistics(
    joint: Hypothesis, base: Mode, longest: Array, ridges: Array
) -> tuple[Array, Array]:
    """G (q, q) and b (q,) per prior scale of every size."""
    d = len(base.point)
    point = np.concatenate([base.point, np.zeros(len(longest))])
    probes = PROBE * ridges.T
    density = joint.log_density(np.vstack([point, point + probes, point - probes]))
    ahead, behind = density[1:].reshape(2, -1)
    curvature = np.maximum((2.0 * density[0] - ahead - behind) / PROBE**2, 1.0)
    lengths = np.minimum(curvature**-0.5, longest)
    axes = np.zeros((len(point), len(point)))
    axes[:d, :d] = base.factor
    axes[:, d:] = ridges * lengths
    gradient, second = hessian(joint.log_density, point, axes, STEP)
    of_base = np.linalg.solve(second[:d, :d], np.column_stack([second[:d, d:], gradient[:d]]))
    told = second[d:, :d] @ of_base[:, :-1] - second[d:, d:] - np.diag(lengths**2)
    score = gradient[d:] - second[d:, :d] @ of_base[:, -1]
    # what bends the other way is not told by the data, and no score can lie in it
    values, vectors = np.linalg.eigh(told)
    seen = vectors[:, values > 0.0]
    gram = (seen * values[values > 0.0]) @ seen.T / np.outer(lengths, lengths)
    return gram, seen @ (seen.T @ score) / lengths
