"""``tune --confirm`` beside a guard: parked while it asks, and answered by a service."""

import json

import pytest
from commands import Fork, finish
from example_nodes import UNCHANGED, start_script
from std_srvs.srv import Trigger

from bo_tuner.plans import EventKind
from bo_tuner.storage.guard_record import read_acts
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.study import strict_yaml

pytestmark = pytest.mark.ros

SAFE = 0.25


@pytest.fixture
def running(empty_domain, tmp_path):
    """Controller and motor, in a domain where nothing else publishes what they do."""
    started = [
        start_script(UNCHANGED / f"{node}_node.py", tmp_path / f"{node}.txt")
        for node in ("motor", "pid")
    ]
    yield
    for process in started:
        process.kill()
        process.wait()


def test_a_guarded_machine_is_parked_while_the_service_is_waited_for(running, peer, tmp_path):
    study = strict_yaml.parse((UNCHANGED / "study.yaml").read_text()).value
    # The default is to keep the limits, which is where a safe search begins.
    study["constraints"]["overshoot"]["upper"] = study["constraints"]["calm"]["upper"] = 1e3
    study["run"]["end"] = {"after": 1.0}
    study |= {
        "park": {"parameters": {"kp": SAFE}},
        "guard": {"always": True, "timeout": 0.5},
        "safe_search": True,
    }
    (tmp_path / "study.yaml").write_text(strict_yaml.dump(study))
    tune = Fork(
        *("tune", "--study", "study.yaml", "--attach", "--confirm", "--quiet"),
        folder=tmp_path,
    )

    def answer(name):
        """Answer once something is asked; before, a request is refused."""

        def answered():
            assert tune.poll() is None, finish(tune)
            response = peer.call(Trigger, f"tuner/{name}", Trigger.Request())
            return response.success

        peer.spin_until(answered, f"the answer {name}")

    try:
        peer.spin_until(lambda: peer.get_parameters("pid", ["kp"]) == [SAFE], "the first question")
        # Longer than the guard would wait for a tuner that does nothing.
        peer.spin_for(2.0)
        assert peer.get_parameters("pid", ["kp"]) == [SAFE]
        answer("accept")
        answer("refuse")
        answer("accept")
        # While a trial runs nothing is asked.
        assert not peer.call(Trigger, "tuner/accept", Trigger.Request()).success
        assert peer.call(Trigger, "tuner/abort", Trigger.Request()).success
        code, _, err = finish(tune)
    finally:
        tune.kill()
    assert code == 143, err
    folder = tmp_path / "runs" / "latest"
    events = read_journal(folder / "journal.sqlite").events
    assert [e.kind for e in events] == [EventKind.ACCEPT, EventKind.REFUSE, EventKind.ACCEPT]
    assert [json.loads(e.detail)["on"] for e in events] == [
        "service ~/accept",
        "service ~/refuse",
        "service ~/accept",
    ]
    assert read_acts(folder / "log") == []
