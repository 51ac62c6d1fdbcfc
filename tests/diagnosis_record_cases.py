"""Made-up records of a diagnosis, for what is said and shown of them."""

from __future__ import annotations

from typing import Any

CAUSE = "thruster_degraded:z3"
SAYS = "Z3 delivers 74 ± 4 % (90 % HDI 66 to 80 %) of its thrust"


def cause(name: str, probability: float, nats: float, **more: Any) -> dict[str, Any]:
    """One entry of ``causes``."""
    return {
        "name": name,
        "probability": probability,
        "log_bayes_factor": nats,
        "parameters": {},
        "confounded_with": [],
        "says": None,
    } | more


def record(*causes: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A record of three events with these causes, most probable first."""
    return {
        "events": ["a", "b", "c"],
        "causes": list(causes),
        "p_value": 0.12,
        "symptoms": [],
        "runner_up": None,
        "baseline": {"rmse_nms": 0.09},
        "extended": {"causes": [causes[0]["name"]]},
        "second_cause_nats": None,
        "gain": {
            "elpd_diff": 9.7,
            "elpd_diff_se": 1.2,
            "heldout_rmse_ratio": 0.9,
            "still_discrepant": False,
            "p_value": 0.4,
            "verdict": "gain",
        },
    } | more


def named(**more: Any) -> dict[str, Any]:
    """Z3 named at 0.96."""
    others = cause("none", 0.03, 0.0), cause("unknown", 0.01, -1.0)
    return record(cause(CAUSE, 0.957, 12.0, says=SAYS), *others, **more)
