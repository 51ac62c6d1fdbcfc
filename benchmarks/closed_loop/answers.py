"""What finished trials say: counts with intervals, by kind and condition, sizes, and a table.

Needs no Basilisk but scipy, which the package's own environment has.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from scipy.stats import binomtest

from closed_loop.trials import STRATA, line

Record = Mapping[str, Any]
CONDITIONS: Final = (
    "branch",
    "controller",
    "events",
    "row_every_s",
    "counter_every_s",
    "counter_step_s",
    "wheel_step_rpm",
    "rate_noise_rad_s",
)
SMALL_P: Final = 0.05
CLEAR_SIGMA: Final = (5.0, 10.0)


def read(out: Path) -> list[Record]:
    """Records of all finished trials in a folder, in order of their numbers."""
    return [json.loads(path.read_text("utf-8")) for path in sorted(out.glob("[0-9]*.json"))]


def verdict(record: Mapping[str, Any]) -> str:
    """How a trial was answered: right, group, unknown, none, wrong, failed or not flown."""
    causes = record["diagnosis"]["causes"]
    if not causes:
        return "not flown" if "not_flown" in record else "failed"
    first = causes[0]
    expected = [hidden["name"] for hidden in record["hidden"]] or ["none"]
    if record["stratum"] == "uncatalogued":
        expected = ["unknown"]
    if first["name"] in expected:
        return "right"
    if set(expected) & set(first.get("confounded_with", ())):
        return "group"
    return first["name"] if first["name"] in ("none", "unknown") else "wrong"


def is_in_group(record: Record) -> bool:
    """Whether what is first is one that ``basilisk_oracle.py`` cannot tell from what is hidden."""
    causes = record["diagnosis"]["causes"]
    return bool(causes) and causes[0]["name"] in record["oracle"]["group"]


def sigma(record: Record) -> float:
    """Size of what a trial hides in σ: the oracle's, which knows of counters, where it has one."""
    of_oracle = record.get("oracle", {}).get("sigma")
    return float(record["hidden"][0]["sigma"] if of_oracle is None else of_oracle)


def sizes(record: Record) -> Iterator[tuple[str, float, tuple[float, float]]]:
    """Hidden sizes that the diagnosis reports: key, truth, and the 90 % interval.

    Of a cause that is among those kept (the eight best). The frequency of an oscillation is that
    of the free spacecraft, which swings faster than the spring alone; a record of earlier code
    lacks it, and its frequency does not count.
    """
    for hidden in record["hidden"]:
        truth = dict(hidden["parameters"])
        if "frequency_hz" in truth:
            truth["frequency_hz"] = record.get("free_frequency_hz")
        found = {cause["name"]: cause for cause in record["diagnosis"]["causes"]}
        reported = found.get(hidden["name"], {}).get("parameters", {})
        for key, size in reported.items():
            if truth.get(key) is not None:
                low, high = size["hdi_90"]
                yield key, truth[key], (low, high)


def summary(records: Sequence[Record]) -> str:
    """Counts of answers by stratum, kind and condition, sizes, and trials that were not right."""
    lines = [f"{len(records)} trials, {records[0]['package']}"]
    for stratum in dict.fromkeys(STRATA):
        own = [record for record in records if record["stratum"] == stratum]
        if own:
            lines += [f"{stratum}: {counted(own)}", *(f"  {each}" for each in shares(own))]
        for key in CONDITIONS:
            if key != "events":
                values = sorted({record["conditions"][key] for record in own})
                lines += [f"  {key} {value}: {counted(_with(own, key, value))}" for value in values]
    lines += [line(record) for record in records if verdict(record) not in ("right", "group")]
    for record in records:
        for key, truth, (low, high) in sizes(record):
            if not low <= truth <= high:
                lines.append(
                    f"{record['index']:5d} {key}: {truth:.5g} is not in {low:.5g} … {high:.5g} "
                    "(90 % HDI)"
                )
    return "\n".join(lines)


def shares(records: Sequence[Record]) -> list[str]:
    """Shares of the trials of one stratum, with 95 % intervals (binomial, exact)."""
    answers = [verdict(record) for record in records if "not_flown" not in record]
    many = len(answers)
    p_values = [record["diagnosis"].get("p_value") for record in records]
    small = [p < SMALL_P for p in p_values if p is not None]
    first = [causes[0]["name"] for r in records if (causes := r["diagnosis"]["causes"])]
    lines = [
        _share("right", answers.count("right"), many),
        _share("right, or listed as confounded with the first", _good(answers), many),
        _share("unknown first", first.count("unknown"), many),
        _share("refused or failed", answers.count("failed"), many),
        _share(f"p-values below {SMALL_P}", sum(small), len(small)),
    ]
    lines += _by_oracle([record for record in records if "oracle" in record])
    held = [low <= truth <= high for record in records for _, truth, (low, high) in sizes(record)]
    if held:
        lines.append(_share("90 % HDIs of sizes that hold the truth", sum(held), len(held)))
    kinds: dict[str, list[str]] = {}
    for record in records:
        for hidden in record["hidden"]:
            kinds.setdefault(hidden["name"].partition(":")[0], []).append(verdict(record))
    by_kind = (f"{kind} {_good(own)} of {len(own)}" for kind, own in sorted(kinds.items()))
    return [*lines, *([f"by kind: {', '.join(by_kind)}"] if kinds else [])]


def _by_oracle(asked: Sequence[Record]) -> list[str]:
    """Shares of the trials that the oracle was asked about."""
    if not asked:
        return []
    low, high = CLEAR_SIGMA
    what = "first is in the oracle's group"
    parts = {
        what: asked,
        f"{what}, {low:g} to {high:g} σ": [r for r in asked if low <= sigma(r) <= high],
        f"{what}, more": [r for r in asked if sigma(r) > high],
        f"{what}, less": [r for r in asked if sigma(r) < low],
    }
    return [_share(text, sum(map(is_in_group, own)), len(own)) for text, own in parts.items()]


def table(records: Sequence[Record]) -> str:
    """One row (CSV) of every trial: conditions, what it hides, and what is first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    answer = ("first", "probability", "named", "confounded", "p_value", "wall_s")
    oracle = ("oracle_sigma", "oracle_group")
    writer.writerow(("trial", "stratum", *CONDITIONS, "hidden", "sigma", *answer, *oracle))
    for record in records:
        conditions = record["conditions"] | {"events": " ".join(record["conditions"]["events"])}
        hidden = record["hidden"]
        said, own = record["diagnosis"], verdict(record)
        first = said["causes"][0] if said["causes"] else {"name": own, "probability": math.nan}
        p_value = said.get("p_value")
        writer.writerow(
            (
                record["index"],
                record["stratum"],
                *(conditions[key] for key in CONDITIONS),
                " ".join(each["name"] for each in hidden),
                " ".join(f"{each['sigma']:.1f}" for each in hidden),
                first["name"],
                f"{first['probability']:.3f}",
                int(own == "right"),
                int(own == "group"),
                "" if p_value is None else f"{p_value:.4f}",
                f"{said.get('wall_s', math.nan):.1f}",
                f"{sigma(record):.2f}" if "oracle" in record else "",
                " ".join(record["oracle"]["group"]) if "oracle" in record else "",
            )
        )
    return text.getvalue()


def counted(records: Sequence[Record]) -> str:
    """How many trials were answered how, and what one took."""
    counts = Counter(verdict(record) for record in records)
    texts = [f"{count} {name}" for name, count in counts.most_common()]
    spent = sorted(r["diagnosis"]["wall_s"] for r in records if "not_flown" not in r)
    median = spent[len(spent) // 2] if spent else math.nan
    return f"{len(records)}: {', '.join(texts)}; median {median:.0f} s"


def _with(records: Sequence[Record], key: str, value: object) -> list[Record]:
    return [record for record in records if record["conditions"][key] == value]


def _good(answers: Sequence[str]) -> int:
    return answers.count("right") + answers.count("group")


def _share(what: str, count: int, many: int) -> str:
    if many == 0:
        return f"{what}: none"
    low, high = binomtest(count, many).proportion_ci(0.95, method="exact")
    return f"{what}: {count} of {many} ({count / many:.3f}; {low:.3f} … {high:.3f}, 95 %)"
