"""Flights by Basilisk, and what a diagnosis says of them: a test that shares no code with the
package.

Basilisk integrates the spacecraft, its wheels and thrusters; three thruster controllers, wheel
ramps and slews fly it in closed loop; telemetry comes in the package's format with the truth beside
it. Conditions (events, cadence, counters, noise, branch, controller and its settings) are drawn for
every trial. The package is met through its command line alone.

``--check``       the generator against conservation laws, closed forms and its own commands
``--recordings``  the six recordings of ``tests/data/basilisk``, anew
``--fly``         one scene, with an effect or without
``--trials``      fly and diagnose trials; one JSON file each, those that exist are kept
``--judge``       diagnose trials anew whose telemetry ``--flights`` kept
``--summary``     what finished trials say, and with ``--table`` a row (CSV) of each

Needs Basilisk (``pip install bsk``), which is no dependency of the package: without it this script
says so and ends, but for ``--judge`` and ``--summary``, which needs scipy (the package's
environment has it).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from pathlib import Path

from closed_loop import trials  # knows Basilisk only once it flies

ROOT = Path(__file__).parents[1]


def read_options() -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--check", action="store_true")
    what.add_argument("--recordings", action="store_true")
    what.add_argument("--fly", type=Path, metavar="DIR", help="folder to write")
    what.add_argument("--trials", metavar="A:B", help="numbers of the trials, B not among them")
    what.add_argument("--judge", metavar="A:B", help="the same of trials that were flown")
    what.add_argument("--summary", action="store_true")
    parser.add_argument("--table", type=Path, metavar="FILE", help="to write with --summary")
    parser.add_argument("--seed", type=int, default=20270214, help="of scenes and trials")
    parser.add_argument("--given", type=json.loads, default={}, help="conditions, as JSON")
    parser.add_argument("--effect", help="to hide with --fly: a name")
    parser.add_argument("--parameters", type=json.loads, default={}, help="its parameters, as JSON")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "basilisk", help="of trials")
    parser.add_argument("--flights", type=Path, help="--out of the trials to --judge")
    parser.add_argument("--command", default="cassini-bayes", help="the package's command line")
    parser.add_argument("--fit", action="store_true", help="fit each trial, too")
    parser.add_argument("--keep", action="store_true", help="keep the telemetry of trials")
    options = parser.parse_args()
    if options.judge and options.flights in (None, options.out):
        parser.error("--judge needs --flights, another folder than --out")
    return options


def summarise(out: Path, table: Path | None) -> int:
    """Print what finished trials say, and write their table; exit status 1 where there are none."""
    from closed_loop import answers

    records = answers.read(out)
    if not records:
        print(f"no trials in {out}: expected numbered JSON files of --trials", file=sys.stderr)
        return 1
    print(answers.summary(records))
    if table is not None:
        table.write_text(answers.table(records), "utf-8")
    return 0


def numbers(asked: str) -> range:
    """Numbers of trials, from A to before B of A:B."""
    first, _, end = asked.partition(":")
    return range(int(first), int(end))


def setting_of(options: argparse.Namespace) -> trials.Setting:
    """The campaign that the command line asks for."""
    return trials.Setting(
        options.seed, options.given, options.out, options.command, options.fit, options.keep
    )


def say(line: str) -> None:
    """A line of a long campaign, at once."""
    print(line, flush=True)


def main() -> int:
    """Do what was asked for; exit status 1 where a check failed."""
    options = read_options()
    if options.summary:
        return summarise(options.out, options.table)
    if options.judge:
        for index in numbers(options.judge):
            trials.judge(setting_of(options), index, options.flights, say)
        if any(options.out.glob("[0-9]*.json")):
            return 0
        print(f"no trials with telemetry in {options.flights} (--keep)", file=sys.stderr)
        return 1
    if importlib.util.find_spec("Basilisk") is None:
        print("Basilisk is not installed (pip install bsk): no flight", file=sys.stderr)
        return 0
    if options.check:
        from closed_loop import checks

        return 0 if checks.report(say) else 1
    if options.recordings:
        from closed_loop import recordings

        recordings.write_all(ROOT / "tests" / "data" / "basilisk", say)
        return 0
    if options.fly is not None:
        from closed_loop import hidden, scene

        effects = [hidden.Effect(options.effect, options.parameters)] if options.effect else []
        drawn = scene.draw_scene(options.seed, options.given)
        scene.write_scene(options.fly, drawn, effects, scene.fly_scene(drawn, effects))
        return 0
    for index in numbers(options.trials):
        trials.run(setting_of(options), index, say)
    return 0


if __name__ == "__main__":
    sys.exit(main())
