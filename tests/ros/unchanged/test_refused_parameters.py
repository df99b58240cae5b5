"""What a node does not take is found before the first trial, and named."""

import pytest
from devices import TWO
from rcl_interfaces.msg import SetParametersResult
from servo import ROOM, SAFE, UNSTABLE, failure, gain, run

from bo_tuner.trials import Evaluation, Stage

pytestmark = pytest.mark.ros


def test_a_node_that_refuses_a_trial(backend, system):
    made = backend(run=ROOM)
    with system.refusing("the key is out"):
        reason = failure(run(made, UNSTABLE))
    assert reason.startswith("servo refused its parameters: the key is out")


def test_a_node_that_does_not_take_its_safe_values_is_named_at_once(refusal, system):
    with system.refusing("the key is out"):
        reason = refusal(park={"parameters": {"gain": SAFE}})
    assert reason == "park: as safe values: servo refused its parameters: the key is out"


@pytest.mark.parametrize(
    ("name", "default", "complaint"),
    [
        ("gian", 0.5, "the node has no parameter 'gian'; did you mean 'gain'"),
        ("serial", 8.0, "'serial' is read-only in the node"),
        ("count", 2.5, "'count' is of type integer in the node, not double"),
        ("limited", 1.5, "9 lies outside the range of 'limited' in the node, [0, 2]"),
    ],
)
def test_a_parameter_that_the_node_does_not_have_as_the_study_says(
    refusal, name, default, complaint
):
    """It is found before the first trial, and not once in each."""
    parameter = {"node": "servo", "type": "double", "bounds": [0, 9], "default": default}
    reason = refusal(parameters={name: parameter})
    assert reason.startswith(f"parameters.{name}: {complaint}"), reason


def test_a_context_variable_that_the_node_does_not_have(refusal):
    context = {"node": "servo", "distribution": "uniform", "bounds": [1, 2], "nominal": 1}
    reason = refusal(contexts={"laod": context})
    assert reason.startswith("contexts.laod: the node has no parameter 'laod'; "), reason


def test_a_context_that_the_node_does_not_take_in_full(refusal):
    """It is found before the first trial, not in those that draw from what is beyond."""
    context = {"node": "servo", "distribution": "uniform", "bounds": [1, 3], "nominal": 1}
    reason = refusal(contexts={"limited": context})
    assert reason == ("contexts.limited: 3 lies outside the range of 'limited' in the node, [0, 2]")


def test_what_an_ordinary_node_refuses_is_not_set_in_parts(backend, system):
    """It takes its parameters together, whatever words it has for a refusal."""
    made = backend()
    asked = []

    def judge(parameters):
        asked.append({item.name: item.value for item in parameters})
        refused = any(item.name == "limited" and item.value > 1.0 for item in parameters)
        return SetParametersResult(successful=not refused, reason="this is unsupported")

    made.close()
    system.add_on_set_parameters_callback(judge)
    made = backend(parameters=TWO)
    asked.clear()
    reason = failure(
        made.outcome(Evaluation(0, 0, Stage.DRAWN, {"gain": 0.375, "limited": 1.5}, {}, 1))
    )
    system.remove_on_set_parameters_callback(judge)
    assert reason.startswith("servo refused its parameters: this is unsupported")
    assert gain(system) == 0.5
    assert {"gain": 0.375} not in asked
    assert {"gain": 0.375, "limited": 1.5} in asked
