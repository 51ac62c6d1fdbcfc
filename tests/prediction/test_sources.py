"""Where a fit came from: inputs are found again, and only as they were."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from prediction_cases import model

from cassini_bayes.balance.totals_system import NOISE
from cassini_bayes.errors import InputError
from cassini_bayes.files.storage import digest
from cassini_bayes.prediction.sources import locate, sources_of


def test_inputs_are_found_from_a_run_folder_elsewhere(tmp_path: Path) -> None:
    """From where the run's record says; what has changed there is named, what is gone is not."""
    inputs, run = tmp_path / "study" / "inputs", tmp_path / "far" / "away" / "run"
    inputs.mkdir(parents=True)
    run.mkdir(parents=True)
    table = inputs / "priors.toml"
    table.write_text("a = 1\n")
    record = {"sha256": {"inputs/priors.toml": digest(table)}, "base": "../../../study"}
    (run / "provenance.json").write_text(json.dumps(record))
    assert locate(run / "fit.nc", "inputs/priors.toml", "--priors") == table
    table.write_text("a = 2\n")
    with pytest.raises(InputError, match=r"got .*study/inputs/priors.toml, which has changed"):
        locate(run / "fit.nc", "inputs/priors.toml", "--priors")
    table.unlink()
    with pytest.raises(InputError, match="got no such file; name it with --priors"):
        locate(run / "fit.nc", "inputs/priors.toml", "--priors")


def test_what_telemetry_did_not_need_is_asked_for_at_once() -> None:
    """All that the priors lack in one message, and where to put it; a wrong layout comes first."""
    own = model().priors
    kept = {name: prior for name, prior in own.parameters.items() if name not in NOISE}
    bare = replace(own, parameters=kept)
    with pytest.raises(InputError, match="a copy, and name it with --priors") as raised:
        sources_of(replace(model(), priors=bare))
    assert all(name in str(raised.value) for name in NOISE)
    craft = own.spacecraft
    other = replace(craft, axis_pairs={**craft.axis_pairs, "+y": craft.axis_pairs["+x"]})
    with pytest.raises(InputError, match=r"axis_pairs .* expected two axes that share"):
        sources_of(replace(model(), priors=replace(bare, spacecraft=other)))
