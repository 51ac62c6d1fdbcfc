"""The platform of a wheel stands at another angle: its axis turned by δθ about the platform's own.

A platform is a target where the priors have its angle (paper 004 eq. 6). To first order the turn is
the tilt u = sin α δθ of the same wheel, α the angle between its axis and the platform's.
"""

from __future__ import annotations

from typing import Final

from cassini_bayes.effects.changes import with_moved_axes
from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.wording import Clause

KIND: Final = Kind(
    "wheel_articulation",
    with_moved_axes,
    says=Clause("the platform of wheel {target} stands {0} from where it should", (("mrad", 1e3),)),
    separation={
        "wheel_alignment": "events at another angle of the platform: the wheel's alignment on it "
        "stays, an error of one angle does not; at one angle only priors tell",
    },
)
