"""Workers over ROS: each has nodes of its own, in a domain of its own."""

import sys
from pathlib import Path

import pytest
from example_nodes import UNCHANGED
from waiting import wait_until

from bo_tuner.backends.factory import make_backend
from bo_tuner.backends.workers.workers import Workers
from bo_tuner.errors import BackendError
from bo_tuner.study.study_file import load_study, study_from_mapping, study_to_mapping
from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

TRIAL = {"kp": 2.0, "ki": 0.0, "kd": 0.375}


def study(**nodes):
    """The study of the example, whose nodes are started with the number of the worker."""
    mapping = study_to_mapping(load_study(str(UNCHANGED / "study.yaml")))
    for signal_of in mapping["signals"].values():
        signal_of["largest_gap"] = 5.0
    del mapping["run"]["abort_when"]
    mapping["nodes"] = {
        name: {
            "node": name,
            "command": f"'{sys.executable}' '{UNCHANGED / f'{name}_node.py'}'",
            "env": {"BENCH": "bench-{worker}"},
        }
        for name in ("pid", "motor")
    } | nodes
    return study_from_mapping(mapping)


@pytest.fixture
def opened(tmp_path):
    """Function that opens two workers of a study."""
    backends = []

    def make(of):
        backends.append(
            make_backend("ros", of, tmp_path, attach=False, ros_arguments=[],
                         interrupted=lambda: None, workers=Workers(2))
        )  # fmt: skip
        backends[-1].open()
        return backends[-1]

    yield make
    for backend in backends:
        backend.close()


def environments():
    """Of the nodes of the example that run: their bench and their domain, by process."""
    found = {}
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        try:
            command = (process / "cmdline").read_bytes()
            variables = (process / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        values = dict(v.split(b"=", 1) for v in variables if b"=" in v)
        if str(UNCHANGED).encode() in command and b"BENCH" in values:
            found[process.name] = (values[b"BENCH"], values[b"ROS_DOMAIN_ID"])
    return found


def test_each_has_its_nodes_its_domain_and_its_log(opened, tmp_path):
    backend = opened(study())
    nodes = environments().values()
    # Two nodes of each worker are in one domain, in which those of the other are not.
    assert sorted(bench for bench, _ in nodes) == [b"bench-1"] * 2 + [b"bench-2"] * 2
    assert len(set(nodes)) == 2
    assert len({domain for _, domain in nodes}) == 2
    assert all((tmp_path / f"worker-{number}" / "motor.log").exists() for number in (1, 2))
    planned = [Evaluation(0, k, Stage.DRAWN, TRIAL, {}, k) for k in range(3)]
    done = list(backend.run(planned))
    while len(done) < len(planned):
        done += backend.run([])
    assert {evaluation.index for evaluation in done} == {0, 1, 2}
    assert all(e.outcome.state is EvaluationState.COMPLETE for e in done), done
    assert backend.park() == []
    backend.close()
    wait_until(lambda: not environments(), "the end of the nodes")


def test_one_whose_nodes_do_not_start_is_named(opened):
    pid = {"node": "pid", "command": "no_such_program --of {worker}"}
    with pytest.raises(BackendError, match=r"worker 1 of 2 cannot be started: .*no_such_program"):
        opened(study(pid=pid))
    assert not environments()
