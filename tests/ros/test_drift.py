"""Fresh runs on nodes that run, beside those of a certificate: `validate --against`."""

import hashlib
import json

import numpy as np
import pytest
from in_process import call
from made_runs import make_run, write_certificate
from short_cuts import small_study
from waiting import DEADLINE

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.cli import validate
from bo_tuner.evidence.certificate.evaluations_file import evaluations_csv
from bo_tuner.evidence.certificate.findings import Evidence
from bo_tuner.evidence.certificate.store import evaluations_path
from bo_tuner.study.study_file import study_from_mapping
from bo_tuner.trials import TUNED, Evaluation, Stage
from bo_tuner.tuning.driver import Driver

pytestmark = pytest.mark.ros

BASELINE = 12


def test_on_attached_nodes(shared_pair, tmp_path, capsys, monkeypatch):
    """Over ROS the axis gives what it gives in process, where the baseline is from."""
    study = study_from_mapping(small_study(1, drawn_contexts=1, search_evaluations=1, seed=3))
    backend = InProcessBackend(study)
    record = make_run(tmp_path / "run", study, backend, result=0, backend_name="ros", attached=True)
    trial = record.trials[0]
    space = study.context_space()
    contexts = map(space.to_dict, space.draw(BASELINE, np.random.default_rng(1)))
    backend.open()
    planned = [
        Evaluation(0, k, Stage.VALIDATION, trial.parameters, context, 100 + k)
        for k, context in enumerate(contexts)
    ]
    ran = tuple(map(Driver(backend).evaluate, planned))
    table = evaluations_csv({TUNED: Evidence(trial.parameters, ran)}, study.contexts, study.metrics)
    digest = hashlib.sha256(table.encode()).hexdigest()
    path = write_certificate(record, trial, evaluations_sha256=digest)
    evaluations_path(path).write_text(table)
    # They may still be starting, on a busy machine.
    monkeypatch.setattr("bo_tuner.backends.ros.bringup.ATTACH_TIMEOUT", DEADLINE)
    code, out, err = call(validate, capsys, "--against", path, "--runs", "3")
    assert code == 0, err
    assert "no drift found" in out
    written = json.loads((record.path / "drift" / "0001.json").read_text())
    assert [run["state"] for run in written["runs"]] == ["complete"] * 3
    backend.close()
    # With the same context and seed these are the runs of the axis in process.
    backend.open()
    for run in written["runs"]:
        again = Driver(backend).evaluate(
            Evaluation(0, 0, Stage.VALIDATION, trial.parameters, run["context"], run["seed"])
        )
        for name in study.of_plant:
            assert run["metrics"][name] == again.outcome.metrics[name]
    backend.close()
