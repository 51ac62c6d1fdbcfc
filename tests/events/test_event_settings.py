"""What run files and mission files say of events alike, and what a command adds to it."""

from __future__ import annotations

import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.events.settings import EventsTable


class Longer(EventsTable):
    """A file with a key of its own."""

    title: str = ""


@pytest.mark.parametrize("of_file", [False, True])
@pytest.mark.parametrize("of_command", [False, True])
def test_what_a_command_accepts_is_added_to_the_file(of_file: bool, of_command: bool) -> None:
    """Mistakes of both, in order; cells are left out if either says so; all else stays."""
    file = Longer(
        events=["a.csv"], priors="p.toml", accept=["units"], leave_out=of_file, title="one"
    )
    both = file.accepting(["wheel-order"], leave_out=of_command)
    assert type(both) is Longer
    assert both.accept == ["units", "wheel-order"]
    assert both.leave_out is (of_file or of_command)
    changed = {"accept", "leave_out"}
    assert both.model_dump(exclude=changed) == file.model_dump(exclude=changed)
    assert (file.accept, file.leave_out) == (["units"], of_file)


def test_a_command_accepts_no_mistake_that_there_is_not() -> None:
    """It is the option that is wrong, not the file."""
    file = Longer(events=["a.csv"], priors="p.toml")
    with pytest.raises(InputError, match="--accept: expected one of"):
        file.accepting(["wheels-order"], leave_out=False)
