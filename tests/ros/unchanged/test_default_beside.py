"""The default beside each evaluation over ROS: it runs first, and is not what is recorded."""

import numpy as np
import pytest
from servo import failure

from bo_tuner.trials import Evaluation, EvaluationState, Stage

pytestmark = pytest.mark.ros

CALM = {"kind": "chance", "metric": "error", "upper": "default + 0.1", "probability": 0.9}
DEFAULT = 0.5


def run(backend, gain, seed=1):
    planned = Evaluation(0, 0, Stage.DRAWN, {"gain": gain}, {}, seed)
    (found,) = backend.run([planned])
    return found.outcome


@pytest.fixture
def compared(backend):
    """An open backend, and the runs that it makes: gains at the start, and recordings."""
    return backend(constraints={"calm": CALM})


def test_the_default_runs_first_and_the_recording_is_the_evaluations(compared, system):
    done = []
    compared.after_extra_run = lambda: done.append(compared.recording)
    found = run(compared, 0.1)
    assert found.state is EvaluationState.COMPLETE, found.reason
    assert system.gains_at_reset[-2:] == [DEFAULT, 0.1]
    default = found.notes.default["error"]
    assert found.metrics["error_minus_default"] == found.metrics["error"] - default
    # A slower servo is farther from its setpoint.
    assert found.metrics["error_minus_default"] > 0.0
    (of_default,) = done
    own = compared.recording.signals["angle"].value
    assert not np.array_equal(own, of_default.signals["angle"].value)
    # The same draw again, which the default need not be run in.
    run(compared, 0.2)
    run(compared, DEFAULT)
    assert system.gains_at_reset[-2:] == [0.2, DEFAULT]
    assert len(done) == 1


def test_a_default_that_fails(compared, system):
    system.silent = True
    found = run(compared, 0.1)
    reason = failure(found)
    assert reason.startswith("the default, to which limits are relative, failed in this context: ")
    assert "angle" in reason
    assert found.ending == "unprepared"
    assert system.gains_at_reset[-1] == DEFAULT
