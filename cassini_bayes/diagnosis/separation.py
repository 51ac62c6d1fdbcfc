"""Which measurement would tell two confounded causes apart."""

from __future__ import annotations

from typing import Final

from cassini_bayes.effects.registry import Kinds
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import couples

SAME_COUPLE: Final = (
    "nothing that fires them together: fire one thruster of the couple alone, or use its own "
    "chamber pressure or temperature"
)
OTHERWISE: Final = "events with other wheel rates, so that other thrusters do the work"


def separating_measurement(kinds: Kinds, priors: Priors, one: str, other: str) -> str:
    """The measurement that would separate two causes, in words.

    Parameters
    ----------
    kinds
        The effects there are, which name what separates them.
    priors
        With their spacecraft and branch: which thrusters only fire together.
    one, other
        Names of causes.
    """
    (kind, _, target), (other_kind, _, other_target) = one.partition(":"), other.partition(":")
    if target and other_target and target != other_target:
        for couple in couples(priors.spacecraft, priors.branch):
            if target in couple and other_target in couple:
                return SAME_COUPLE
    return kinds.separation(kind, other_kind) or OTHERWISE
