"""The command line. Exit status: 0 done, 1 not converged or a check failed, 2 bad input."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, Final

import typer

from cassini_bayes import __version__
from cassini_bayes.cli import (
    calibrations,
    checks,
    diagnoses,
    fits,
    listings,
    predictions,
    reports,
    simulations,
    starts,
    sweeps,
    trends,
)
from cassini_bayes.cli.options import spread
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.errors import CassiniBayesError

app = typer.Typer(
    name="cassini-bayes",
    help="Bayesian posteriors of a spacecraft's thruster forces from wheel-bias telemetry.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)

NOT_FINITE = "array must not contain infs or NaNs"
"""What scipy says of arithmetic that broke down, as a plain ``ValueError``."""
INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it; typer turns the interrupt into it."""

COMMANDS: Final[Mapping[str, Callable[..., None]]] = {
    "init": starts.init_command,
    "check": checks.check_command,
    "run": fits.run_command,
    "fit": fits.fit_command,
    "report": reports.report_command,
    "diagnose": diagnoses.diagnose_command,
    "simulate": simulations.simulate_command,
    "sweep": sweeps.sweep_command,
    "trend": trends.trend_command,
    "predict": predictions.predict_command,
    "plan": predictions.plan_command,
    "causes": listings.causes_command,
    "parameters": listings.parameters_command,
    "quantities": listings.quantities_command,
    "diagnose-published": calibrations.diagnose_published_command,
}
for name, command in COMMANDS.items():
    app.command(name)(spread(command))
app.add_typer(calibrations.app, name="calibrate")


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"cassini_bayes {__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point: errors become one line on standard error, never a traceback."""
    # numbers are in arrays: there is little to collect, and what a command imports stays
    gc.set_threshold(100_000)
    try:
        with one_thread():
            app()
    except CassiniBayesError as error:
        _print_error(str(error))
        sys.exit(error.exit_code)
    except ImportError as error:
        if (error.name or "").startswith(__name__.partition(".")[0]):
            raise  # a mistake of this package, not of its environment
        _print_error(f"{error.name or 'a library'}: {error}; install the package anew")
        sys.exit(2)
    except OSError as error:
        place = error.filename or "the system"
        reason = error.strerror or str(error)
        _print_error(f"{place}: {reason}; check the path, its permissions and the free space")
        sys.exit(2)
    except (OverflowError, ValueError) as error:
        # numpy's error by name: it is imported by the commands that need it
        names = ("OverflowError", "LinAlgError")
        if type(error).__name__ not in names and NOT_FINITE not in str(error):
            raise
        reason = "a prior or a value may be far out of range: compare units and sizes with the data"
        _print_error(f"the arithmetic broke down ({error}); {reason}")
        sys.exit(2)
    except MemoryError as error:
        _print_error(
            f"not enough memory ({error}); ask for fewer draws or walkers, or fewer events"
        )
        sys.exit(2)
    except SystemError as error:
        if not _is_interrupt(error):
            raise
        _print_stopped()
        sys.exit(INTERRUPTED)
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            _print_stopped()
        raise
    finally:
        gc.freeze()  # what is left goes with the process: a last collection takes most of a second


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: compiled code in which it falls ends in a SystemError."""
    if error is None or isinstance(error, KeyboardInterrupt):
        return error is not None
    return _is_interrupt(error.__cause__ or error.__context__)


def _print_stopped() -> None:
    typer.echo(
        "stopped; a run, fit or diagnosis goes on with the same command and --resume, a sweep, a "
        "trend or a campaign with the same command",
        err=True,
    )


def _print_error(text: str) -> None:
    typer.echo(f"error: {' '.join(text.split())}", err=True)
