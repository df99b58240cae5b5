"""Lifecycle nodes in the steps of a run."""

import pytest
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from servo import failure, run

from bo_tuner.trials import EvaluationState

pytestmark = pytest.mark.ros


class Camera(LifecycleNode):
    """Notes its transitions, and refuses what it is told to refuse."""

    def __init__(self, context):
        super().__init__("camera", context=context)
        self.done = []
        self.refuses = ""

    def _judge(self, transition):
        if transition == self.refuses:
            return TransitionCallbackReturn.FAILURE
        self.done.append(transition)
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state):
        return self._judge("configure")

    def on_activate(self, state):
        return self._judge("activate")

    def on_deactivate(self, state):
        return self._judge("deactivate")

    def on_cleanup(self, state):
        return self._judge("cleanup")


@pytest.fixture
def camera(join):
    return join(Camera)


def steps(*transitions):
    return [{"lifecycle": {"node": "camera", "transition": name}} for name in transitions]


ANEW = steps("deactivate", "cleanup", "configure", "activate")


def test_each_run_starts_anew(backend, camera):
    made = backend(run={"before": ANEW})
    assert [run(made).state for _ in range(2)] == [EvaluationState.COMPLETE] * 2
    # At first there is nothing to take back.
    forth, back = ["configure", "activate"], ["deactivate", "cleanup"]
    assert camera.done == forth + back + forth


def test_a_transition_that_is_refused(backend, camera):
    made = backend(run={"before": ANEW})
    camera.refuses = "activate"
    assert failure(run(made)) == "camera refused to activate; it was inactive"
    camera.refuses = ""
    assert run(made).state is EvaluationState.COMPLETE


def test_a_transition_that_the_node_does_not_have_in_its_state(backend, camera):
    """Asked for, it would end a node of rclpy."""
    made = backend(run={"before": steps("activate")})
    expected = "camera cannot activate: it is unconfigured, and can configure, shutdown"
    assert failure(run(made)) == expected


def test_no_lifecycle_node(refusal, camera):
    step = {"lifecycle": {"node": "servo", "transition": "activate"}}
    assert refusal(run={"before": [step]}).startswith(
        "run.before[0].lifecycle.node: there is no lifecycle node servo; expected one of /camera"
    )
