"""Paper 003 Table 1 with its navigation column: force from Doppler beside torque from the wheels.

A study estimate is a torque over a lever arm, y = F (1 − s e / L) with e the shift of the centre of
mass and s the side of the thruster; navigation sees the force F itself. So a shift moves one column
and a weak thruster both. Y1 and Y3 (and Y2 and Y4) fire together and are one estimate (eq. 6).

Given shift and deficits the thrusts F_k = c (1 − d_k) + own departure are normal, so the evidence
is a Gaussian density averaged over quadrature nodes of what is left: one or two numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Final

import numpy as np
import pandas as pd
from scipy.special import logsumexp
from scipy.stats import halfnorm, norm

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published import a_branch_thrusts, published_constants

COMMON_N, COMMON_SD_N = 0.75, 0.05  # paper 000, before the recharge and after alike within 2 sigma
ERROR: Final = 0.02  # of one figure: the two columns differ by 2.3 to 6.3 %
SHIFT_SD_M: Final[Mapping[str, float]] = {"x": 0.013, "y": 0.0057}  # 10 % (paper 003)
FACTOR: Final = 5.0  # by which a doubted centre of mass is wider, as in the diagnosis
DEFICIT_SCALE: Final = 0.2
UNKNOWN_SCATTER: Final = 0.15
NONE, UNKNOWN, CATALOGUED = 0.5, 0.05, 0.45
NODES, SHIFTS = 41, 121
GROUPS: Final = ("z1", "z2", "z3", "z4", "y1_y3", "y2_y4")
_SIDES: Final = {"x": (1, -1, -1, 1, 0, 0), "y": (1, 1, -1, -1, 0, 0)}


@dataclass(frozen=True)
class Table:
    """Estimates of the six groups: study (6,), and navigation of the first four or none."""

    study_n: Array
    navigation_n: Array  # (4,) or (0,)
    uses_study: bool = True

    @property
    def values(self) -> Array:
        """All figures in one vector."""
        study = self.study_n if self.uses_study else self.study_n[:0]
        return np.concatenate([study, self.navigation_n])

    @property
    def groups(self) -> list[int]:
        """Group of every figure."""
        study = list(range(6)) if self.uses_study else []
        return [*study, *range(len(self.navigation_n))]

    @property
    def sees_torque(self) -> Array:
        """1 for a study figure, 0 for one of navigation."""
        return np.array([1.0] * (6 * self.uses_study) + [0.0] * len(self.navigation_n))


def lever_arm_m(axis: str) -> float:
    """Corner of the thruster pods along an axis of the body, as paper 000 prints it."""
    return published_constants().value("paper_000_geometry", f"thruster_l{axis}_m")


def table_1() -> Table:
    """The printed table: six estimates of the study, four of navigation."""
    rows = {row.thruster: row for row in a_branch_thrusts()}
    names = ("z1a", "z2a", "z3a", "z4a", "y1a", "y2a")
    study = np.array([rows[name].this_study_n.value for name in names])
    navigation = [rows[name].other_n for name in names[:4]]
    return Table(study, np.array([figure.value for figure in navigation if figure is not None]))


@dataclass(frozen=True)
class Hypothesis:
    """What is wrong: weak groups, a doubted axis of the centre of mass, or scatter unknown."""

    name: str
    weak: tuple[int, ...] = ()
    doubted: str = ""
    scatter: float | None = None
    prior: float = 0.0


def hypotheses() -> list[Hypothesis]:
    """``none``, ``unknown``, single causes, pairs of weak groups, and each with a c.m. shift."""
    share, shift = CATALOGUED / 2 / 6, CATALOGUED / 2 / 2
    names = [f"thruster_degraded:{group}" for group in GROUPS]
    singles = [Hypothesis(name, (i,), prior=share) for i, name in enumerate(names)]
    axes = [Hypothesis(f"center_of_mass:{a}", doubted=a, prior=shift) for a in "xy"]
    pairs = [
        Hypothesis(f"{names[i]}+{names[j]}", (i, j), prior=share**2)
        for i, j in combinations(range(6), 2)
    ]
    mixed = [
        Hypothesis(f"{names[i]}+center_of_mass:{a}", (i,), a, prior=share * shift)
        for i, a in product(range(6), "xy")
    ]
    return [
        Hypothesis("none", prior=NONE),
        Hypothesis("unknown", scatter=UNKNOWN_SCATTER, prior=UNKNOWN),
        *singles,
        *axes,
        *pairs,
        *mixed,
    ]


@dataclass(frozen=True)
class Nodes:
    """What figures say at nodes of shift and deficits: their log density, and the posterior there.

    Mean and variance (n, 6) of the groups' thrusts and (n,) of the common level.
    """

    log_density: Array  # (n,)
    thrust_n: Array
    thrust_var: Array
    common_n: Array
    common_var: Array

    @property
    def log_evidence(self) -> float:
        """Of nodes that are as likely beforehand."""
        return float(logsumexp(self.log_density) - np.log(len(self.log_density)))

    @property
    def weights(self) -> Array:
        """Posterior probabilities (n,) of the nodes."""
        return np.asarray(np.exp(self.log_density - logsumexp(self.log_density)))


def weigh(table: Table, hypothesis: Hypothesis, scatter: float, width: float = 1.0) -> Nodes:
    """A hypothesis at a quadrature's nodes; ``width`` scales the priors of what it doubts.

    Deficits and a doubted shift are taken at midpoints of their priors' quantiles; a shift that is
    not doubted is narrow and enters the covariance to first order.
    """
    spread = hypothesis.scatter if hypothesis.scatter is not None else scatter
    quantiles = (np.arange(NODES) + 0.5) / NODES
    spaces = [halfnorm.ppf(quantiles, scale=DEFICIT_SCALE * width) for _ in hypothesis.weak]
    if hypothesis.doubted:
        sd = FACTOR * width * SHIFT_SD_M[hypothesis.doubted]
        spaces.append(sd * norm.ppf((np.arange(SHIFTS) + 0.5) / SHIFTS))
    grid = np.array(list(product(*spaces))) if spaces else np.zeros((1, 0))
    deficit = np.zeros((len(grid), 6))
    deficit[:, list(hypothesis.weak)] = np.minimum(grid[:, : len(hypothesis.weak)], 0.95)
    shift = np.zeros((len(grid), 2))
    if hypothesis.doubted:
        shift[:, "xy".index(hypothesis.doubted)] = grid[:, -1]
    return _gaussian(table, deficit, shift, spread, hypothesis.doubted)


def _gaussian(table: Table, deficit: Array, shift: Array, scatter: float, doubted: str) -> Nodes:
    """The figures at deficits (n, 6) and shifts (n, 2).

    Unknowns are the common level, six own departures, and the shifts that are not doubted.
    """
    groups, torque = table.groups, table.sees_torque
    n, factor, columns, widths = len(deficit), np.ones((len(deficit), len(groups))), [], []
    for i, axis in enumerate("xy"):
        side = np.array([_SIDES[axis][g] for g in groups]) * torque / lever_arm_m(axis)
        factor = factor * (1.0 - side * shift[:, [i]])
        if axis != doubted:
            columns.append(-side * COMMON_N * (1.0 - deficit[:, groups]))
            widths.append(SHIFT_SD_M[axis])
    departures = np.broadcast_to(scatter * COMMON_N * np.eye(6), (n, 6, 6))
    nothing = np.zeros((n, 6, len(widths)))
    thrust = np.concatenate([(1.0 - deficit)[..., None], departures, nothing], axis=-1)
    design = factor[..., None] * thrust[:, groups]
    design[..., 7:] = np.stack(columns, axis=-1) if columns else design[..., 7:]
    prior = np.array([COMMON_SD_N**2, *([1.0] * 6), *(w**2 for w in widths)])
    mean = np.array([COMMON_N, *([0.0] * (len(prior) - 1))])
    covariance = (design * prior) @ np.swapaxes(design, -1, -2)
    covariance = covariance + np.diag((ERROR * table.values) ** 2)
    residual = table.values - design @ mean
    gain = np.swapaxes(np.linalg.solve(covariance, design * prior), -1, -2)
    solved = np.linalg.solve(covariance, residual[..., None])[..., 0]
    log_det = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    after = mean + (gain @ residual[..., None])[..., 0]
    spread = np.diag(prior) - gain @ (design * prior)
    return Nodes(
        -0.5 * ((residual * solved).sum(-1) + log_det),
        (thrust @ after[..., None])[..., 0],
        np.einsum("nku,nuv,nkv->nk", thrust, spread, thrust, optimize=True),
        after[:, 0],
        spread[:, 0, 0],
    )


def ranking(table: Table, scatter: float, width: float = 1.0) -> pd.DataFrame:
    """Every hypothesis with its log Bayes factor against ``none`` and its probability."""
    known = hypotheses()
    log_evidence = np.array([weigh(table, one, scatter, width).log_evidence for one in known])
    total = log_evidence + np.log([one.prior for one in known])
    rows = {
        "name": [one.name for one in known],
        "log_bayes_factor": log_evidence - log_evidence[0],
        "probability": np.exp(total - logsumexp(total)),
    }
    return pd.DataFrame(rows).sort_values("probability", ascending=False, ignore_index=True)


def losses(
    table: Table, scatter: float, weak: Sequence[int] = (2, 3)
) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    """Two losses of each weak group, mean and sd: from the common level, and since 2007.

    The second counts from the thruster's own level of 2007, which nothing here has seen: its prior
    is the common level with the scatter of healthy thrusters. Both are at one pressure.
    """
    one = weigh(table, Hypothesis("pair", tuple(weak)), scatter)
    rng = np.random.default_rng(1)
    place = rng.choice(len(one.weights), size=100_000, p=one.weights)
    common = one.common_n[place] + np.sqrt(one.common_var[place]) * rng.standard_normal(len(place))
    result = {}
    for group in weak:
        spread = np.sqrt(one.thrust_var[place, group])
        thrust = one.thrust_n[place, group] + spread * rng.standard_normal(len(place))
        start = common * (1.0 + scatter * rng.standard_normal(len(place)))
        from_common, since = 1.0 - thrust / common, 1.0 - thrust / start
        result[GROUPS[group]] = (
            (float(from_common.mean()), float(from_common.std())),
            (float(since.mean()), float(since.std())),
        )
    return result


def shift_from_ratio(table: Table) -> tuple[float, float]:
    """Shift of the centre of mass along Y by study over navigation alone, mean and sd, m."""
    ratio = table.study_n[:4] / table.navigation_n
    sides = np.array(_SIDES["y"][:4]) / lever_arm_m("y")
    sd = ratio * np.hypot(ERROR, ERROR)
    weight = (sides / sd) ** 2
    shift = (sides * (1.0 - ratio) / sd**2).sum() / weight.sum()
    return float(shift), float(weight.sum() ** -0.5)


def without_navigation(table: Table) -> Table:
    """The study alone, six estimates."""
    return replace(table, navigation_n=table.navigation_n[:0])
