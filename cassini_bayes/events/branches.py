"""Events of one thruster branch: what a fit takes, where a mission takes both."""

from __future__ import annotations

from cassini_bayes.errors import InputError


def require_branch(where: str, flown: str, branch: str) -> None:
    """Refuse an event that another branch flew than the priors describe.

    Raises
    ------
    InputError
        With the way to fit events of several branches together: a mission file.
    """
    if flown != branch:
        raise InputError(
            f"{where}: branch",
            f"branch {branch} as in the priors file",
            f"branch {flown}",
            "use the priors of that branch; events of several branches go together in a mission "
            "file: cassini-bayes trend MISSION.toml",
        )
