"""What events can see, from their Gram matrices: it comes true, and blind events are blind."""

from __future__ import annotations

import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomli_w
from event_cases import PRIORS, events, model, priors
from totals_cases import flight

from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.model import build_model, log_posterior
from cassini_bayes.model.draws import draw, draw_prior
from cassini_bayes.model.observability import _information, event_worth, observability
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.sampling.warmstart import warm_start


@pytest.mark.parametrize(("names", "within"), [(("bias",), 5 / 3), (("bias", "slews"), 4 / 3)])
def test_expected_widths_come_true(names: tuple[str, ...], within: float) -> None:
    """Expected over prior widths are those of the posterior, within a third.

    Of a bias alone within two thirds: its torque noise and share of close pulses, far below their
    prior means here, decide how well momentum is known between firings.
    """
    joint = model(*names)
    table = observability(joint).table.set_index("quantity")
    warm = warm_start(
        partial(log_posterior, joint), joint.space.dimension, np.random.default_rng(3)
    )
    weights = np.exp(warm.draws.log_weights)
    mean = weights @ warm.draws.z
    width = np.sqrt(weights @ (warm.draws.z - mean) ** 2)
    asked = [n for n, b in zip(joint.space.names, joint.space.blocks, strict=True) if b != "noise"]
    places = [joint.space.names.index(name) for name in asked]
    expected = table.loc[asked, "ratio"].to_numpy(dtype=float)
    told = expected > 0.05  # narrower ones depend on where in the prior the truth lies
    assert told.sum() > 10
    assert np.abs(np.log(width[places][told] / expected[told])).max() < np.log(within)


@pytest.mark.parametrize("name", ["bias", "slews"])
def test_information_is_symmetric_and_never_negative(name: str) -> None:
    """What is known of two unknowns has no order, and no direction is known less than not."""
    joint = model(name)
    information = _information(joint, joint.unknowns)
    largest = np.abs(information).max()
    assert np.abs(information - information.T).max() < 1e-12 * largest
    assert np.linalg.eigvalsh(information)[0] > -1e-12 * largest
    assert np.isfinite(observability(joint).table["ratio"]).all()


def test_slews_see_inertia_and_biases_see_thrust() -> None:
    """A slew has no thrust to see; a bias sees nothing of the height of the Z thrusters."""
    slews = observability(model("slews"))
    assert not slews.table["block"].eq("thrust").any()
    moments = [f"inertia_{e}_kg_m2" for e in ("xx", "yy", "zz")]
    assert set(slews.table.set_index("quantity").loc[moments, "verdict"]) == {"seen well"}
    bias = observability(model("bias")).table.set_index("quantity")
    assert bias.loc["thruster_lzz_m", "verdict"] == "not seen"
    assert bias.loc["thrust[all events,y2]", "ratio"] < 0.9


def test_more_events_see_no_less() -> None:
    """Adding slews narrows every expected width or leaves it."""
    alone = observability(model("bias")).table.set_index("quantity")["ratio"]
    both = observability(model("bias", "slews")).table.set_index("quantity")["ratio"]
    assert (both.reindex(alone.index) <= alone * (1 + 1e-9)).all()


def test_an_event_is_worth_what_a_model_without_it_lacks() -> None:
    """Left out by subtracting its information, and by building the model without it: the same."""
    rows, priors = flight(2)
    cases = [
        (model("bias", "slews"), "slews", model("bias")),
        (build_model(rows, priors), rows[1].id, build_model(rows[:1], priors)),
    ]
    for all_of_them, left_out, rest in cases:
        worth = event_worth(all_of_them)
        own = worth[worth["event"] == left_out].set_index("quantity")["narrowing"]
        both, alone = (
            observability(m).table.set_index("quantity")["expected_sd"] for m in (all_of_them, rest)
        )
        shared = [name for name in own.index if name in alone.index]
        assert len(shared) > 15
        np.testing.assert_allclose(own[shared], 1.0 - both[shared] / alone[shared], atol=1e-6)
        assert own[shared].max() > 0.01


@pytest.mark.parametrize("name", ["thruster_degraded:z3", "thrust_scale"])
def test_thrusts_of_events_are_those_with_effects(name: str) -> None:
    """Prior and expected widths of an event's thrusts have the effect's factor, as draws have.

    From the onset on; before it, and for levels, there is none.
    """
    rows, priors = flight()
    ids = [event.id for event in rows]
    (effect,) = named_effects([f"{name}@{ids[5]}"], priors, priors.wheels, ["totals"], order=ids)
    joint = build_model(rows, priors, delta_v="ignore", effects=[effect])
    table = observability(joint).table.set_index("quantity")
    rng, n = np.random.default_rng(1), 4_000
    density = partial(log_posterior, joint)
    warm = warm_start(density, joint.space.dimension, rng)
    before = draw_prior(joint, n, rng).thrusts.thrust_n.std(0)
    after = draw(joint, warm.draws.resample(rng, n), rng).thrusts.thrust_n.std(0)
    for i in (4, 5):
        own = table.loc[[f"thrust[{ids[i]},{k}]" for k in joint.thrusters]]
        np.testing.assert_allclose(own["prior_sd"], before[i], rtol=0.08)
        np.testing.assert_allclose(own["expected_sd"], after[i], rtol=0.12)
    grown = table["prior_sd"][f"thrust[{ids[5]},z3]"] / table["prior_sd"][f"thrust[{ids[4]},z3]"]
    assert grown > 1.5


def test_thrusts_of_a_recording_are_those_with_effects() -> None:
    """The same of telemetry, whose effects are of a term of one event."""
    (effect,) = named_effects(["thruster_degraded:z3"], priors(), priors().wheels, ["telemetry"])
    joint = build_model(events("bias"), priors(), effects=[effect])
    table = observability(joint).table.set_index("quantity")
    drawn = draw_prior(joint, 4_000, np.random.default_rng(1)).thrusts.thrust_n[:, 0].std(0)
    own = table.loc[[f"thrust[bias,{k}]" for k in joint.thrusters], "prior_sd"]
    np.testing.assert_allclose(own, drawn, rtol=0.08)


def test_fixed_departures_of_thrust_change_nothing_of_what_is_shared(tmp_path: Path) -> None:
    """No departures per event (their priors fixed at 0): levels are seen as with tiny ones."""

    def seen(width: str) -> pd.Series[float]:
        path = tmp_path / "priors.toml"
        path.write_text(priors_with_departures(width), encoding="utf-8")
        joint = build_model(events("bias"), read_priors(path))
        return observability(joint).table.set_index("quantity")["ratio"]

    fixed = seen("fixed = 0.0")
    tiny = seen('dist = "norm"\nloc = 0.0\nscale = 1e-7').loc[fixed.index]
    assert fixed.index.str.startswith("thrust[bias").sum() == 8
    np.testing.assert_allclose(fixed, tiny, rtol=1e-3)


def priors_with_departures(width: str) -> str:
    """The telemetry priors with other priors of the departures of an event's thrusts."""
    text = PRIORS.read_text(encoding="utf-8")
    for name in ("thrust_event_n", "thrust_jitter_n"):
        old = f'[parameters.{name}]\ndist = "norm"\nloc = 0.0\nscale = 0.01'
        assert old in text
        text = text.replace(old, f"[parameters.{name}]\n{width}")
    return text


def test_the_words_name_what_is_tied_together() -> None:
    """Moments and wheel inertias scale together in slews: said, and singular values are sorted."""
    seen = observability(model("slews"))
    assert any("inertia_xx_kg_m2" in s and "rwa" in s for s in seen.sentences if "tied" in s)
    assert np.all(np.diff(seen.singular_values) <= 1e-9)
    assert seen.sentences[0].startswith("Expected before sampling")
    blind = observability(model("bias")).table["ratio"].max()
    assert blind == pytest.approx(1.0, abs=1e-6)


def test_nothing_that_is_asked_for_is_said_and_no_error(tmp_path: Path) -> None:
    """Slews with all but the noise fixed: an empty table, a sentence, and a model all the same."""
    free = model("slews")
    table = tomllib.loads(PRIORS.read_text("utf-8"))
    walked = zip(free.space.names, free.space.blocks, free.space.distributions, strict=True)
    for name, block, prior in walked:
        if block != "noise":
            entry = table["parameters"][name]
            middle = float(prior.quantile_of_standard(np.zeros(1))[0])
            kept = {key: entry[key] for key in ("unit", "source") if key in entry}
            table["parameters"][name] = {"fixed": middle, **kept}
    path = tmp_path / "priors.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    noise = build_model(events("slews"), read_priors(path))
    assert set(noise.space.blocks) == {"noise"}
    seen = observability(noise)
    assert seen.table.empty
    assert list(seen.table.columns[:3]) == ["quantity", "block", "unit"]
    assert seen.sentences == (
        "Thrust levels, inertia and all nuisances but noise are fixed: nothing to see.",
    )
