"""Options that several commands share, and how progress is shown."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn

import typer
from rich.console import Console
from rich.control import Control
from rich.segment import ControlType

from cassini_bayes.files.checks import LARGEST_SEED

if TYPE_CHECKING:
    from cassini_bayes.sampling.ensembles import ProgressReport

SeedOverride = Annotated[
    int | None,
    typer.Option(
        "--seed",
        min=0,
        max=LARGEST_SEED,
        help="Random seed, in place of the file's or the default.",
    ),
]
MaxSteps = Annotated[
    int | None,
    typer.Option(
        "--max-steps",
        min=100,
        help="Steps after which sampling gives up, in place of the file's or the default.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, max=LARGEST_SEED, help="Random seed.")]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable result on stdout.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", help="No progress: results, warnings and errors alone.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing result.")]
Accept = Annotated[
    list[str] | None,
    typer.Option(
        "--accept",
        metavar="MISTAKE",
        help="A mistake that data were refused for and that is none; may be repeated.",
    ),
]
LeaveOut = Annotated[
    bool, typer.Option("--leave-out", help="Leave out single cells of telemetry that do not fit.")
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Leave out figures and HTML report.")]
Strict = Annotated[
    bool,
    typer.Option("--strict", help="Exit with 1 where data, priors and physics contradict."),
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=1, help="Worker processes (default and most: one for each core)."),
]
Dask = Annotated[
    str | None, typer.Option("--dask", help="Workers of a Dask scheduler, e.g. tcp://host:8786.")
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint.")]
PriorsFile = Annotated[Path, typer.Option("--priors", help="Priors file.")]
Source = Annotated[str, typer.Option("--source", help="Which rows of a totals CSV.")]
GivenSource = Annotated[
    str | None,
    typer.Option("--source", help="Which rows of a totals CSV.", show_default="flight"),
]
FittedEffects = Annotated[
    list[str] | None,
    typer.Option("--effect", help="Effect to fit by name, thruster_leak:z3; may be repeated."),
]
Effects = Annotated[
    list[Path] | None,
    typer.Option("--effects", help="Effects of your own (.py) or tables of effects (.toml)."),
]


@dataclass(frozen=True)
class Plausibility:
    """Options of a command that reads data: what is accepted of them, what counts as failure."""

    accept: Accept = None
    leave_out: LeaveOut = False
    strict: Strict = False

    @property
    def policy(self) -> dict[str, Any]:
        """As the verbs of the package take it."""
        return {"accept": self.accept or [], "leave_out": self.leave_out}

    def end(
        self, warnings: Sequence[str], *, converged: bool = True, said: bool = False
    ) -> NoReturn:
        """Say warnings, which stand last, unless the result ``said`` them; end with the status."""
        warn(() if said else warnings)
        raise typer.Exit(0 if converged and not (self.strict and warnings) else 1)


@dataclass(frozen=True)
class Output:
    """Options of a command that shows a result."""

    as_json: Json = False
    quiet: Quiet = False

    def show(self, record: Callable[[], str], text: Callable[[], str]) -> None:
        """The result on standard output: its record, or as text."""
        typer.echo(record() if self.as_json else text())


@dataclass(frozen=True)
class Restart:
    """Options of a command that keeps what it has finished."""

    force: Force = False
    resume: Resume = False


def spread(command: Callable[..., object], **defaults: object) -> Callable[..., object]:
    """A command whose groups of options, dataclasses among its parameters, are options of it.

    ``defaults`` are those of this command where they are not those of the group.
    """
    written = signature(command, eval_str=True).parameters
    groups = {
        key: signature(it.annotation, eval_str=True).parameters
        for key, it in written.items()
        if isinstance(it.annotation, type) and is_dataclass(it.annotation)
    }
    options = {
        name: own.replace(default=defaults.get(name, own.default), kind=Parameter.KEYWORD_ONLY)
        for key, it in written.items()
        for name, own in groups.get(key, {key: it}).items()
    }

    def spread_command(**given: Any) -> object:
        for key, members in groups.items():
            given[key] = written[key].annotation(**{name: given.pop(name) for name in members})
        return command(**given)

    vars(spread_command)["__signature__"] = Signature(list(options.values()))
    spread_command.__annotations__ = {name: own.annotation for name, own in options.items()}
    spread_command.__doc__ = command.__doc__
    return spread_command


def command_line() -> list[str]:
    """What was typed, for the record."""
    return ["cassini-bayes", *sys.argv[1:]]


def warn(sentences: Sequence[str]) -> None:
    """Sentences about what is doubtful, on standard error."""
    for sentence in sentences:
        typer.echo(f"warning: {sentence}", err=True)


PLAIN_S: Final = 2.0  # between lines of progress where there is no terminal to overwrite them in


class ConsoleReporter:
    """Progress on standard error: a live line in a terminal, plain lines elsewhere."""

    def __init__(self, quiet: bool) -> None:
        self._console = Console(stderr=True, quiet=quiet, highlight=False, soft_wrap=True)
        self._began = time.monotonic()
        self._first: dict[str, tuple[float, int]] = {}
        self._counted = -math.inf

    def log(self, text: str, *, stays: bool = True) -> None:
        """A line with the seconds since the start; in a terminal it may make way for the next."""
        if self._console.is_terminal and not self._console.quiet:
            self._console.control(
                Control((ControlType.ERASE_IN_LINE, 2), ControlType.CARRIAGE_RETURN)
            )
        end = "\n" if stays or not self._console.is_terminal else "\r"
        line = f"[{time.monotonic() - self._began:6.1f} s] {text}"
        self._console.print(line, markup=False, end=end)

    def progress(self, report: ProgressReport) -> None:
        """Steps done, steps and time left, and what is still missing."""
        if report.failed:
            seconds = report.seconds_left
            duration = "" if math.isnan(seconds) else f", {seconds:.0f} s"
            self.log(
                f"step {report.step}: about {report.steps_left} steps{duration} left; "
                f"waiting for {', '.join(report.failed)}"
            )
        else:
            self.log(f"step {report.step}: stop rule met")

    def count(self, what: str, done: int, total: int) -> None:
        """What is done of a stage or campaign, and the time left.

        A live line in a terminal; elsewhere the first, the last, and one every few seconds.
        """
        now = time.monotonic()
        is_plain = not self._console.is_terminal
        if is_plain and what in self._first and done < total and now < self._counted + PLAIN_S:
            return
        self._counted = now
        if what not in self._first:
            self._first[what] = (now, done)
        since, already = self._first[what]
        left = (total - done) * (now - since) / (done - already) if done > already else float("nan")
        rest = f", {left:.0f} s left" if left == left else ""
        if 1 == total - done < done:  # what takes longest is what is left: a chain among draws
            rest = ", the last one is at work"
        self.log(f"{what}: {done} of {total}{rest}", stays=done == total)
        if done == total:
            del self._first[what]  # the next stage of that name has a time of its own
