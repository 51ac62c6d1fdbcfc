"""Which mistake explains a misfit best, what else would, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known

MISTAKES: Final = {
    "wheel-order": "wheel columns that belong to other wheels",
    "wheel-sign": "wheel rates of the opposite sign",
    "wheel-unit": "wheel rates in another unit",
    "wheel-factor": "a wheel's rate times a factor",
    "wheel-offset": "a wheel's rate with a constant error",
    "wheel-silent": "a wheel column that does not tell its wheel's rate: stuck, or a copy",
    "wheel-time": "wheel rates that are early or late",
    "start-end": "rates before and after a bias exchanged",
    "thruster-order": "counters that belong to other thrusters",
    "counter-time": "counters that are early or late",
    "on-time-unit": "on-times in another unit",
    "pulse-count": "pulses counted more than once",
    "rate-axes": "body rates about other axes",
    "rate-sign": "body rates of the opposite sign",
    "rate-unit": "body rates in another unit",
    "rate-factor": "body rates times a factor",
    "rate-silent": "body rates that do not tell the motion",
    "rate-time": "body rates that are early or late",
    "attitude-convention": "quaternions in another convention",
    "attitude-time": "attitudes that are early or late",
    "time-unit": "times in another unit",
    "open-balance": "a balance of momentum that nothing closes",
    "bad-cell": "single cells that do not fit",
    "same-telemetry": "the same data under another id",
}
"""What ``--accept`` takes, and what each means."""
PHYSICS: Final = "physics"
"""In place of a mistake's name: a cause that the catalogue holds, no reason to refuse anything."""
SUSPECT: Final = 30.0
"""Misfit beyond noise's below which nothing is asked. This and what follows were set by trial on
simulated events; what they do to others is measured (docs/results/mistakes.md)."""
UNKNOWN: Final = 300.0
"""Misfit above which an event is flagged though no mistake explains it: nearly all honest events
stay below (docs/results/mistakes.md)."""
MOST_LEFT: Final = 150.0
"""Misfit that a mistake may leave of a large one."""
EXPLAINED: Final = 0.35
"""Of the misfit: a mistake that leaves less explains it."""
LEAST_GAIN: Final = 25.0
"""Misfit that it has to remove beyond its price: twelve nats."""
AS_GOOD: Final = 10.0
"""Difference of misfits (five nats) within which data do not tell two mistakes apart."""
MOST_NAMED: Final = 3  # that a line can hold


class MistakeError(InputError):
    """Data that a mistake explains better than physics does.

    Parameters
    ----------
    mistakes
        Names of :data:`MISTAKES`, the best first: those that explain it as well are there too.
    """

    def __init__(
        self, where: str, expected: str, got: str, fix: str, mistakes: tuple[str, ...]
    ) -> None:
        self.mistakes = mistakes
        super().__init__(where, expected, got, fix)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return type(self), (self.where, self.expected, self.got, self.fix, self.mistakes)


@dataclass(frozen=True)
class Policy:
    """What the user has said about mistakes: accepted ones, and whether bad cells are left out."""

    accepted: frozenset[str] = frozenset()
    leave_out: bool = False

    @classmethod
    def of(
        cls, accepted: Sequence[str], *, leave_out: bool = False, where: str = "--accept"
    ) -> Policy:
        """From names, given ``where``.

        Raises
        ------
        InputError
            An unknown mistake.
        """
        check_mistakes(accepted, where)
        return cls(frozenset(accepted), leave_out)


def check_mistakes(names: Sequence[str], where: str) -> None:
    """Refuse names that are of no mistake.

    Raises
    ------
    InputError
        An unknown mistake, with the nearest one.
    """
    for name in names:
        check_known(where, name, MISTAKES)


STRICT: Final = Policy()
"""Nothing accepted, nothing left out."""


@dataclass(frozen=True)
class Explanation:
    """One mistake, undone: what the data then look like, how to mend it, what misfit is left.

    ``price`` is what its freedom costs: a factor that is free explains more than one that is not.
    """

    mistake: str
    what: str
    fix: str
    left: float
    price: float = 0.0

    @property
    def score(self) -> float:
        """Misfit left and price: the least is the best."""
        return self.left + self.price


@dataclass
class Findings:
    """What a policy did not refuse but has to be said, in sentences.

    ``mapped_by`` is the channel map that the columns come from, if they do.
    """

    policy: Policy
    mapped_by: str = ""
    sentences: list[str] = field(default_factory=list)

    def refuse(
        self,
        mistake: str,
        where: str,
        expected: str,
        got: str,
        fix: str,
        others: Sequence[str] = (),
    ) -> None:
        """Raise, unless the mistake was accepted: then say so.

        Raises
        ------
        MistakeError
            It was not; ``others`` explain the data as well.
        """
        if mistake not in self.policy.accepted:
            if self.mapped_by:
                fix += f" (by source, unit, sign, order or direction in {self.mapped_by})"
            fix = f"{fix}; or, if it is none, add --accept {mistake}"
            names = tuple(dict.fromkeys((mistake, *others)))
            raise MistakeError(where, expected, got, fix, names)
        self.sentences.append(f"{where}: accepted ({mistake}): {got}")

    def refuse_best(
        self, where: str, expected: str, misfit: float, best: Sequence[Explanation]
    ) -> None:
        """Refuse with the best explanation; what fits as well is said too."""
        first, *others = best
        also = ""
        if others:
            named = " or ".join(f"{each.what} ({each.left:.3g})" for each in others)
            also = f", and as well {named}"
        got = f"{first.what} (misfit {first.left:.3g} instead of {misfit:.4g}{also})"
        as_good = [each.mistake for each in others]
        self.refuse(first.mistake, where, expected, got, first.fix, as_good)


def best_explanations(
    misfit: float,
    explanations: Sequence[Explanation],
    least_gain: float = LEAST_GAIN,
    passes: float = 0.0,
) -> tuple[Explanation, ...]:
    """The explanation that leaves least, and those as good; empty if none explains the misfit.

    A mistake explains it if it leaves a third of it, or no more than what ``passes``.
    """
    ranked = sorted(explanations, key=lambda each: each.score)
    if not ranked or misfit - ranked[0].score < least_gain:
        return ()
    # of a large misfit a third is as large as no honest event's: that is not explained either
    if ranked[0].left > min(max(EXPLAINED * misfit, passes), MOST_LEFT):
        return ()
    close = [each for each in ranked if each.score <= ranked[0].score + AS_GOOD]
    return tuple(close[:MOST_NAMED])
