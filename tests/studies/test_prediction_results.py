"""Leave one event out, plans, the ΔV requirement, the ground software, commands and the page."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import run_cases
from prediction_cases import SIZE, beliefs, flights, folds, learned, model, write_run_folder
from totals_cases import B_BRANCH, FLIGHT

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.prediction.ground_software import (
    GroundInputs,
    ground_prediction,
    prior_parameters,
)
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.leave_one_out import column_difference, fold, skill
from cassini_bayes.prediction.navigation import requirements, spread
from cassini_bayes.prediction.physics import (
    arms_of,
    importance_physics,
    momentum_per_rpm,
    physics_of_fit,
    stretch,
)
from cassini_bayes.prediction.planning import (
    Plan,
    _Judge,
    end_rates,
    plan,
    plan_csv,
    plan_dictionary,
    plan_text,
    quantity_draws,
)
from cassini_bayes.prediction.predict import predict
from cassini_bayes.prediction.requests import BiasRequest, parse_bias, parse_epoch, request_of
from cassini_bayes.prediction.summary import as_csv, as_text, lines
from cassini_bayes.report.plots.prediction import (
    leave_one_out_figure,
    plan_figure,
    prediction_figure,
    requirement_figure,
    totals_figure,
)
from cassini_bayes.spacecraft.description import PLANNED_WHEEL_RPM, Spacecraft
from cassini_bayes.studies.closed_loop import simulate_request
from cassini_bayes.studies.prediction import page_body
from cassini_bayes.studies.prediction.findings import (
    COLUMNS,
    Findings,
    hydrazine_floor,
    scaled_firing,
    table_csv,
)

LINE = "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729"


def column(source: str, first: int = 8) -> tuple[TotalsEvent, ...]:
    """Rows of one source of the published totals."""
    return read_totals(FLIGHT, flights()[1].spacecraft, source)[:first]


# ---- leave one out ------------------------------------------------------------------------------


def falsified(event: TotalsEvent) -> TotalsEvent:
    """The event as if everything but its wheel rates, branch and date had been otherwise."""
    assert event.pulses is not None
    assert event.delta_v_m_s is not None
    return replace(
        event,
        on_time_s=3.0 * event.on_time_s + 7.0,
        pulses=event.pulses + 50.0,
        duration_s=event.duration_s + 300.0,
        delta_v_m_s=-2.0 * event.delta_v_m_s,
        hydrazine_g=99.0,
        mass_kg=1234.5,
        thrust_predicted_n=0.5,
    )


def every_draw(events: tuple[TotalsEvent, ...], row: int) -> list[Array]:
    """All draws of a fold's prediction."""
    p = fold(events, row, flights()[1], beliefs(), 5, SIZE).prediction
    assert p.delta_v_computed_m_s is not None
    assert p.delta_v_delivered_m_s is not None
    assert p.hydrazine_g is not None
    return [
        *(p.on_time_s, p.pulses, p.duration_s, p.hydrazine_g),
        *(p.delta_v_computed_m_s, p.delta_v_delivered_m_s),
    ]


def test_the_held_out_event_is_not_used() -> None:
    """Whatever the held-out event's figures, its prediction is the same to the last bit."""
    events, _ = flights(3)
    other = (falsified(events[0]), *events[1:])
    for own, changed in zip(every_draw(events, 0), every_draw(other, 0), strict=True):
        np.testing.assert_array_equal(own, changed)


def test_the_other_events_are_used() -> None:
    """Negative control: the same falsification of another event changes the prediction."""
    events, _ = flights(3)
    other = (events[0], falsified(events[1]), events[2])
    for own, changed in zip(every_draw(events, 0), every_draw(other, 0), strict=True):
        assert not np.array_equal(own, changed)


def test_a_prediction_depends_on_its_own_wheel_rates() -> None:
    """Negative control: other rates of the held-out event give other on-times."""
    events, _ = flights(3)
    other = (replace(events[0], rwa_end_rpm=events[0].rwa_end_rpm + 50.0), *events[1:])
    assert not np.array_equal(every_draw(events, 0)[0], every_draw(other, 0)[0])


def test_two_events_are_too_few() -> None:
    """At least two have to teach."""
    with pytest.raises(InputError, match="at least three"):
        fold(flights()[0][:2], 0, flights()[1], beliefs(), 1)


def test_columns_average_as_paper_001_does() -> None:
    """0.59 s, 0.79 mm/s, 1.05 g for the calibrated column, 0.46 s for FSDS; none for flight."""
    units = folds()[0].prediction.units
    events = flights()[0]
    gsw = column_difference(events, column("gsw"), units)
    assert gsw["on_time"] == pytest.approx(0.5885, abs=1e-3)
    assert gsw["delta_v_z"] == pytest.approx(0.79125, abs=2e-3)
    assert gsw["hydrazine"] == pytest.approx(1.05, abs=1e-9)
    assert column_difference(events, column("fsds"), units)["on_time"] == pytest.approx(
        0.46, abs=0.005
    )
    assert "pulses" not in column_difference(events, column("gsw_ideal"), units)
    assert set(column_difference(events, events, units).values()) == {0.0}


def test_skill_of_a_perfect_prediction_is_perfect() -> None:
    """Draws moved onto the outcome: no difference, full coverage; far off: none."""
    held = folds()[0]
    p = held.prediction
    right = replace(p, on_time_s=np.tile(held.event.on_time_s, (SIZE, 1)))
    scores = skill([replace(held, prediction=right)])["on_time"]
    assert scores.mean_absolute_difference == 0.0
    assert scores.coverage == 1.0
    wrong = replace(p, on_time_s=p.on_time_s + 100.0)
    assert skill([replace(held, prediction=wrong)])["on_time"].coverage == 0.0


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fit.nc in a run folder that no test changes."""
    return write_run_folder(tmp_path_factory.mktemp("run"))


# ---- physics from a fit -------------------------------------------------------------------------


def test_a_fit_gives_its_own_draws_back(fit: Path) -> None:
    """Parameters, thrusts and software read from fit.nc are rows of the fit that wrote it."""
    from cassini_bayes.results.record import read_fit

    found = physics_of_fit(model(), fit, np.random.default_rng(1), 50)
    posterior = read_fit(fit).posterior
    own = posterior["cm_x_m"].values.ravel()
    rows = [
        int(np.flatnonzero(own == value)[0]) for value in np.asarray(found.parameters["cm_x_m"])
    ]
    thrust = posterior["thrust_n"].values.reshape(SIZE, 8, 8)
    np.testing.assert_array_equal(found.thrust_n, thrust[rows])
    inertia = posterior["rwa_inertia_kg_m2"].values.reshape(SIZE, 3)
    np.testing.assert_array_equal(found.parameters["rwa4_inertia_kg_m2"], inertia[rows, 2])


def test_a_fit_of_other_events_is_refused(fit: Path, tmp_path: Path) -> None:
    """Ids or on-times that differ, and files that are no fit."""
    from cassini_bayes.model import build_model

    events, priors = flights()
    rng = np.random.default_rng(1)
    with pytest.raises(InputError, match="a fit of the events"):
        physics_of_fit(build_model(events[:3], priors), fit, rng, 10)
    changed = (replace(events[0], on_time_s=events[0].on_time_s + 1.0), *events[1:])
    with pytest.raises(InputError, match="other on-times"):
        physics_of_fit(build_model(changed, priors), fit, rng, 10)
    (tmp_path / "no.nc").write_text("nothing")
    with pytest.raises(InputError, match=r"fit\.nc"):
        physics_of_fit(model(), tmp_path / "no.nc", rng, 10)


@pytest.mark.statistical
def test_importance_draws_are_those_of_the_posterior() -> None:
    """Means of the walked parameters against the self-normalised weights of other draws."""
    from functools import partial

    from cassini_bayes.model import build_model, log_posterior
    from cassini_bayes.sampling.warmstart import warm_start

    events, priors = flights(3)
    small = build_model(events, priors)
    found, k = importance_physics(small, np.random.default_rng(2), 2_000)
    assert k < 0.7
    other = warm_start(
        partial(log_posterior, small), len(small.space.names), np.random.default_rng(3)
    ).draws
    weights = np.exp(other.log_weights)
    for name in ("tau_fall_s", "cm_x_m", "hold_rate_rad_s"):
        values = np.asarray(small.space.to_parameters(other.z)[name])
        centre = float(weights @ values)
        sd = float(np.sqrt(weights @ (values - centre) ** 2))
        assert abs(np.mean(np.asarray(found.parameters[name])) - centre) < 0.2 * sd


# ---- plans --------------------------------------------------------------------------------------


def small_plan(quantity: str = "impulse_per_on_time_y2_n", **options: float) -> Plan:
    """Two end rates per sign and wheel."""
    return plan(learned(), quantity, (1, 2, 4), (-526.0, -1060.0, -442.0), levels=2, **options)


def test_information_is_that_of_the_sampled_moments() -> None:
    """ρ² from the balance's residual, draw by draw in a plain loop, agrees to rounding."""
    known, quantity = learned(), quantity_draws(learned(), "impulse_per_on_time_y2_n")
    judge = _Judge.of(known, quantity, (1, 2, 4))
    u = np.array([3.0, 1.0, 2.0, 4.0, 0.5, 9.0, 0.5, 9.0])
    start, end = np.array([100.0, -200.0, 300.0]), np.array([700.0, 300.0, -400.0])
    arms = arms_of(model(), known.physics)
    kappa = stretch(model(), known.physics, known.pulses.coefficients[:, 0])
    columns = momentum_per_rpm(model(), known.physics)[:, :, [0, 1, 3]]
    residual = np.array(
        [
            arms[i] @ (known.physics.level_n[i] * kappa[i] * u) - columns[i] @ (end - start)
            for i in range(SIZE)
        ]
    )
    both = np.cov(np.column_stack([residual, quantity]).T, bias=True)
    h0, h1 = columns.mean(0) @ start, columns.mean(0) @ end
    mean_arm = (arms * kappa[:, None]).mean(0) * u
    own = model().thrust_prior.departures
    noise = judge.inertia_noise + mean_arm @ own @ own.T @ mean_arm.T
    for h in (h0, h1):
        noise = noise + judge.attitude**2 * (h @ h * np.eye(3) - np.outer(h, h))
    wanted = both[3, :3] @ np.linalg.solve(both[:3, :3] + noise, both[:3, 3]) / both[3, 3]
    assert judge.correlation_square(u, end - start, start, end) == pytest.approx(wanted, rel=1e-9)


def test_plans_keep_to_the_wheels_limits() -> None:
    """Ends within ±2000 rev/min and outside ±300; gains positive, sorted; σ shrinks with them."""
    found = small_plan()
    assert len(found.candidates) == 5**3 - 1  # each wheel may stay, but not all of them
    gains = [c.information_nats for c in found.candidates]
    assert gains == sorted(gains, reverse=True)
    assert min(gains) >= 0.0
    for c in found.candidates:
        assert all(300.0 <= abs(rate) <= 2000.0 for rate in c.end_rpm)
        assert c.sd_after == pytest.approx(found.sd_before * np.exp(-c.information_nats))
    np.testing.assert_allclose(
        end_rates(3, PLANNED_WHEEL_RPM), [-2000, -1150, -300, 300, 1150, 2000]
    )


def test_the_front_is_not_beaten() -> None:
    """No candidate costs less and teaches more than one of the front."""
    found = small_plan()
    for best in found.front():
        assert not any(
            c.hydrazine_g < best.hydrazine_g and c.information_nats >= best.information_nats
            for c in found.candidates
        )


def test_budgets_and_bad_plans() -> None:
    """A budget bounds hydrazine; a hopeless one, unknown names and bad starts are errors."""
    assert all(c.hydrazine_g <= 20.0 for c in small_plan(budget_g=20.0).candidates)
    with pytest.raises(InputError, match="raise it"):
        small_plan(budget_g=0.01)
    with pytest.raises(InputError, match="did you mean 'cm_x_m'"):
        small_plan("cm_xm")
    with pytest.raises(InputError, match="within ±2000"):
        plan(learned(), "cm_x_m", (1,), (2500.0,))
    with pytest.raises(InputError, match="levels"):
        end_rates(0, PLANNED_WHEEL_RPM)


def test_a_plan_prefers_the_thrusters_it_asks_about() -> None:
    """The best bias for Y2 fires Y2 more than the best one for Z3 does, and vice versa."""
    y2 = small_plan("impulse_per_on_time_y2_n").candidates[0].on_time_s
    z3 = small_plan("impulse_per_on_time_z3_n").candidates[0].on_time_s
    assert y2[5] > z3[5]
    assert z3[2] > y2[2]


# ---- requirement, ground software ---------------------------------------------------------------


def test_the_requirement_is_judged_by_component() -> None:
    """Z is judged and not met; X and Y are next to nothing; each source alone leaves less."""
    event = flights()[0][0]
    x, y, z = requirements(learned(), request_of(event), 3)
    assert np.isnan(x.probability)
    assert np.isnan(y.probability)
    assert 0.0 < z.probability < 0.9973
    assert not z.met
    assert z.without_m_s["limit cycle"] < z.spread_m_s
    assert spread(np.random.default_rng(1).standard_normal(100_000)) == pytest.approx(1.0, abs=0.02)


def test_the_ideal_column_is_reproduced() -> None:
    """All 48 ideal on-times within 0.17 s, 0.05 s on average; ΔVz and hydrazine accordingly."""
    priors = flights()[1]
    parameters = prior_parameters(priors)
    misses, grams, speed = [], [], []
    for event in column("gsw_ideal"):
        assert event.thrust_predicted_n is not None
        assert event.mass_kg is not None
        assert event.delta_v_m_s is not None
        assert event.hydrazine_g is not None
        found = ground_prediction(
            GroundInputs(
                priors.spacecraft, "B", parameters, event.thrust_predicted_n, event.mass_kg
            ),
            request_of(event),
        )
        misses.append(np.abs(found.on_time_s - event.on_time_s)[:6])
        speed.append(abs(1e3 * (found.delta_v_m_s - event.delta_v_m_s)[2]))
        grams.append(abs(found.hydrazine_g - event.hydrazine_g))
    assert np.max(misses) < 0.17
    assert np.mean(misses) < 0.05
    assert max(speed) < 0.1
    assert max(grams) < 0.5


def test_the_ideal_column_needs_its_own_thrust() -> None:
    """Negative control: five percent less thrust misses the column."""
    priors, event = flights()[1], column("gsw_ideal")[0]
    found = ground_prediction(
        GroundInputs(priors.spacecraft, "B", prior_parameters(priors), 0.95 * 0.77, 2414.4),
        request_of(event),
    )
    assert np.abs(found.on_time_s - event.on_time_s).max() > 0.5


# ---- summary, figures, page ---------------------------------------------------------------------


def test_lines_and_tables_agree() -> None:
    """Quantiles in order, one row per quantity, inertial ΔV with a quaternion."""
    request = replace(request_of(flights()[0][0]), quaternion=(0.0, 1.0, 0.0, 0.0))
    p = predict(learned(), request, np.random.default_rng(1))
    found = {line.quantity: line for line in lines(p)}
    assert {"on_time_y1_y3", "pulses_z4", "hydrazine", "duration"} <= set(found)
    for line in found.values():
        assert line.low_90 <= line.median <= line.high_90
    turned = found["delta_v_computed_inertial_z"]  # half a turn about Y
    assert turned.median == pytest.approx(-found["delta_v_computed_body_z"].median)
    assert as_csv([p]).count("\n") == len(found) + 1
    assert as_text(p).count("\n") == len(found) + 1


def test_figures_are_drawn() -> None:
    """Axes carry units; every held-out event has a panel with six units."""
    columns = {source: column(source) for source in COLUMNS}
    figure = leave_one_out_figure(folds(), columns)
    titles = [axes.get_title() for axes in figure.axes if axes.get_visible()]
    assert titles == [held.event.id.removesuffix("-bias") for held in folds()]
    labels = [axes.get_ylabel() for axes in totals_figure(folds(), columns).axes]
    assert labels == ["ΔVz − flight [mm/s]", "hydrazine − flight [g]"]
    judged = {h.event.id: requirements(h.learned, request_of(h.event), 1)[2] for h in folds()}
    assert "%" in requirement_figure(judged).axes[0].get_ylabel()
    assert "[g]" in plan_figure(small_plan()).axes[0].get_xlabel()
    assert "[s]" in prediction_figure(folds()[0].prediction).axes[0].get_ylabel()
    nothing = dict.fromkeys(("delta_v_computed_m_s", "delta_v_delivered_m_s", "hydrazine_g"))
    bare = prediction_figure(replace(folds()[0].prediction, **nothing))
    assert [axes.get_ylabel() for axes in bare.axes] == ["on-time [s]", "pulses [count]"]


def test_the_page_reports_what_was_scored() -> None:
    """Skill, verdicts and every event stand on the page; the CSV has a row per on-time."""
    scores = skill(folds())
    findings = Findings(
        events=flights(3)[0],
        columns={source: column(source, 3) for source in COLUMNS},
        folds=folds(),
        scores=scores,
        requirement={h.event.id: requirements(h.learned, request_of(h.event), 1) for h in folds()},
        sensitivity={"halved": scores, "doubled": scores},
    )
    text = page_body(findings, flights()[1], "prediction")
    assert f"**{scores['on_time'].mean_absolute_difference:.2f}**" in text
    assert text.count("| predicted |") == 3
    assert table_csv(findings).count("\n") == 1 + 18
    assert set(hydrazine_floor(findings)) == {"flight", "flight, by axis", "fsds"}


def test_scaled_priors_scale_the_firing_logic_only() -> None:
    """Half-normal scales halve, everything else stays."""
    found = scaled_firing(beliefs(), 0.5).distributions
    own = beliefs().distributions
    assert found["event_spread"].mean() == pytest.approx(0.5 * own["event_spread"].mean())
    assert found["minor_quantum_s"] == own["minor_quantum_s"]
    assert found["wheel_loop_s"] == own["wheel_loop_s"]


# ---- commands -----------------------------------------------------------------------------------


def test_predict_answers_with_json_csv_and_figures(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a run folder alone: JSON on stdout, files in --out, in a time that is reported."""
    arguments = ["predict", "--fit", str(fit), "--bias", LINE, "--quaternion", "0 0 0 1", "--json"]
    assert run_cases.command([*arguments, "--out", str(tmp_path / "out")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["seconds"] < 20.0
    predicted = document["biases"][0]["predicted"]
    assert predicted["on_time_z1"]["low_90"] < 23.43 < predicted["on_time_z1"]["high_90"] + 3.0
    assert json.loads((tmp_path / "out" / "prediction.json").read_text()) == document
    assert (tmp_path / "out" / "prediction.csv").read_text().startswith("bias,quantity,unit")
    assert (tmp_path / "out" / "figures" / "planned.png").stat().st_size > 10_000


def test_a_file_of_biases_is_predicted(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A CSV gives one answer per row; options fill in what it leaves open."""
    path = tmp_path / "planned.csv"
    path.write_text("id,rwa1_rpm_start,rwa1_rpm_end\na,0,500\nb,0,-500\n")
    arguments = [
        "predict",
        "--fit",
        str(fit),
        "--bias",
        str(path),
        "--epoch",
        "2010-05-01",
        "--json",
    ]
    assert run_cases.command(arguments) == 0
    biases = json.loads(capsys.readouterr().out)["biases"]
    assert [b["id"] for b in biases] == ["a", "b"]
    assert {b["epoch"] for b in biases} == {"2010-05-01T00:00:00+00:00"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--bias", "rwa3: 0 -> 500"], "not prime"),
        (["--bias", "rwa1: 0 -> 2500"], "within ±2000"),
        (["--bias", "rwa1: 0 -> 500", "--branch", "C"], "one of A, B"),
        (["--bias", "rwa1: 0 -> 500", "--epoch", "2004-01-01"], "from 2009-08-22 on"),
        (["--bias", "nowhere.csv"], "nowhere.csv"),
    ],
)
def test_bad_requests_are_one_line(
    fit: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    """Exit status 2, nothing on stdout, one line that says what to change."""
    capsys.readouterr()
    assert run_cases.command(["predict", "--fit", str(fit), *arguments]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert said in output.err


def test_a_fit_whose_files_have_changed_is_refused(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another digest, or no run folder around: name the files, and it works."""
    fit = Path(shutil.copytree(fit.parent, tmp_path / "copy")) / "fit.nc"
    (fit.parent / "provenance.json").write_text(json.dumps({"sha256": {str(B_BRANCH): "0"}}))
    arguments = ["predict", "--fit", str(fit), "--bias", LINE, "--quiet"]
    assert run_cases.command(arguments) == 2
    assert "--priors" in capsys.readouterr().err
    named = [*arguments, "--priors", str(B_BRANCH), "--events", str(FLIGHT)]
    assert run_cases.command(named) == 0
    (fit.parent / "resolved.toml").unlink()
    assert run_cases.command([*arguments, "--priors", str(B_BRANCH)]) == 2
    assert "--events" in capsys.readouterr().err
    assert run_cases.command(["predict", "--fit", str(tmp_path / "no.nc"), "--bias", LINE]) == 2
    assert "no such file" in capsys.readouterr().err


def test_plan_ranks_from_a_run_folder(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last event's end rates are the start; JSON, text, CSV and figure agree on the best."""
    arguments = ["plan", "--fit", str(fit), "--quantity", "cm_x_m", "--levels", "2"]
    assert run_cases.command([*arguments, "--json", "--out", str(tmp_path / "out")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["from_rpm"] == [-526.0, -1060.0, -442.0]
    best = document["most_informative"][0]
    first = (tmp_path / "out" / "plan.csv").read_text().splitlines()[1].split(",")
    assert [float(cell) for cell in first[:3]] == best["to_rpm"]
    assert (tmp_path / "out" / "plan.png").exists()
    assert run_cases.command([*arguments, "--from", "rwa3: 5"]) == 2
    assert "prime wheels" in capsys.readouterr().err


def test_plan_minimises_from_a_run_folder(fit: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One wheel's end is given, the others are found; JSON and text, and bad use in one line."""
    arguments = ["plan", "--fit", str(fit), "--minimise", "z_throughput"]
    assert run_cases.command([*arguments, "--to", "rwa4: 700", "--limit", "80", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [choice["to_rpm"][2] for choice in document["choices"]] == [700.0] * 4
    assert any(row["exceeds"] for row in document["throughput_s"].values())
    assert run_cases.command([*arguments, "--to", "rwa4: 700"]) == 0
    assert "least z_throughput from [-526, -1060, -442]" in capsys.readouterr().out
    assert run_cases.command(arguments) == 2
    assert "--to" in capsys.readouterr().err
    assert run_cases.command(arguments[:3]) == 2
    assert "either --quantity or --minimise" in capsys.readouterr().err


def test_plan_texts() -> None:
    """Candidates by information and per gram; the CSV has a row for each."""
    found = small_plan()
    assert plan_csv(found).count("\n") == len(found.candidates) + 1
    other = replace(found, wheel_names=("rw1", "rw2", "rw3")[: len(found.wheels)])
    unknown = tuple(replace(c, hydrazine_g=np.nan) for c in found.candidates)
    rows = list(csv.DictReader(plan_csv(replace(other, candidates=unknown)).splitlines()))
    assert {"rw1_rpm_end", "sd_after", "unit"} <= rows[0].keys()
    assert (rows[0]["hydrazine_g"], rows[0]["unit"]) == ("", found.unit)
    assert "rw1" in plan_text(other, 3)
    text = plan_text(found, 3)
    assert text.count("\n") == 12
    assert " N (1 sd) before" in text
    assert "1 sd after [N]" in text
    assert "rwa1" in text
    document = plan_dictionary(found, 3)
    per_gram = [
        e["information_nats"] / max(e["hydrazine_g"], 1e-9) for e in document["most_per_gram"]
    ]
    assert per_gram == sorted(per_gram, reverse=True)


@pytest.mark.slow
def test_the_closed_loop_flies_the_same_bias() -> None:
    """Two simulated flights: the busy thrusters' on-times within a fifth of the prediction's."""
    request = parse_bias("rwa1: -700 -> -300, rwa4: -400 -> -600", model().spacecraft)
    flown = simulate_request(learned(), request, 2, 1)
    predicted = np.median(predict(learned(), request, np.random.default_rng(1)).on_time_s, axis=0)
    busy = predicted > 2.0
    assert busy.any()
    np.testing.assert_allclose(flown.on_time_s.mean(0)[busy], predicted[busy], rtol=0.2)


def test_the_closed_loop_flies_the_spacecraft_of_the_fit() -> None:
    """That of the fit's priors and not the one that the package has under its name."""
    request = parse_bias("rwa1: -700 -> -300, rwa4: -400 -> -600", model().spacecraft)
    other = replace(model().spacecraft, name="observer", control_cycle_s=0.5)
    fit = learned()
    own = replace(fit, model=replace(fit.model, spacecraft=other))
    with pytest.raises(InputError, match="flown"):
        _flown_with(own, request)


def _flown_with(own: Learned, request: BiasRequest) -> None:
    """Stops where the plan is made, with the spacecraft in it."""
    with pytest.MonkeyPatch.context() as patch:

        def stop(_: object, spacecraft: Spacecraft, *__: object) -> None:
            assert spacecraft is own.model.spacecraft
            raise InputError("flown", "stop", "stop", "stop")

        patch.setattr("cassini_bayes.simulation.make_plan", stop)
        simulate_request(own, request, 1, 1)


def test_the_closed_loop_has_the_thrusts_that_are_predicted() -> None:
    """At the epoch asked for, with departures of the event, and all the spacecraft's geometry."""
    epoch = parse_epoch("2014-01-01")
    request = replace(
        parse_bias("rwa1: -700 -> -300, rwa4: -400 -> -600", model().spacecraft), epoch=epoch
    )
    flown: list[dict[str, Any]] = []

    def stop(document: dict[str, Any], **_: object) -> None:
        flown.append(document)
        raise InputError("flown", "stop", "stop", "stop")

    for seed in range(20):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("cassini_bayes.simulation.reader.scenario_of", stop)
            with pytest.raises(InputError, match="flown"):
                simulate_request(learned(), request, 1, seed)
    moved = learned().thrust_moved_n(epoch)[0]
    level = learned().physics.delivered_n(learned().model)[0].mean()
    assert abs(moved) > 0.01  # years after the last event
    common = np.array([document["truth"]["thrust_common_n"] for document in flown])
    assert common.std() > 0.0
    assert abs(common.mean() - level - moved) < 4 * common.std() / np.sqrt(len(common))
    geometry = model().spacecraft.geometry_of("B").parameters
    assert set(geometry) <= flown[0]["truth"].keys()
