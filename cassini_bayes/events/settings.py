"""What files of settings say of events: which, under which priors, and what of them is accepted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from pydantic import Field

from cassini_bayes.events.plausibility.verdict import check_mistakes
from cassini_bayes.files.validated import Table


class EventsTable(Table):
    """The keys that run files and mission files have alike; paths are relative to the file."""

    events: list[str] = Field(min_length=1, examples=[["file.csv"]])
    priors: str
    source: str = "flight"
    accept: list[str] = Field(default_factory=list)  # mistakes that are none
    leave_out: bool = False  # bad cells

    def accepting(self, mistakes: Sequence[str], *, leave_out: bool) -> Self:
        """The same with what a command accepts besides.

        Raises
        ------
        InputError
            An unknown mistake.
        """
        check_mistakes(mistakes, "--accept")
        accept = [*self.accept, *mistakes]
        return self.model_copy(update={"accept": accept, "leave_out": self.leave_out or leave_out})
