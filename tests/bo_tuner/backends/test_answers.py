"""What answers of services say: which fields tell that something was not done, and why."""

from types import SimpleNamespace

import pytest
from action_msgs.srv import CancelGoal
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_srvs.srv import Empty, Trigger

from bo_tuner.backends.ros.answers import check_expected, refusal
from bo_tuner.errors import StudyError
from bo_tuner.study.steps import Call

REFUSED = SetParametersResult(successful=False, reason="too high")
TAKEN = SetParametersResult(successful=True)


class Code:
    """As messages with a code have its values beside it."""

    RESULT_OK = SUCCESS = 1

    def __init__(self, **fields):
        self.__dict__.update(fields)


def answer(**fields):
    return SimpleNamespace(**fields)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (Trigger.Response(success=False, message="the brake is on"), "the brake is on"),
        (Trigger.Response(success=False), "success is false"),
        (answer(ok=False, message="Could not activate arm"), "Could not activate arm"),
        (answer(ok=False), "ok is false"),
        (answer(mode_sent=False), "mode_sent is false"),
        (answer(status=answer(success=False, message="in manual mode")), "in manual mode"),
        (answer(result=Code(result=4, error_message="no such entity")), "no such entity"),
        (answer(error_code=Code(val=-31)), "error_code.val is -31"),
        (CancelGoal.Response(return_code=CancelGoal.Response.ERROR_REJECTED), "return_code is 1"),
        (SetParameters.Response(results=[TAKEN, REFUSED]), "too high"),
        (SetParametersAtomically.Response(result=REFUSED), "too high"),
    ],
)
def test_one_that_says_no(said, reason):
    assert refusal(said, {}) == reason


@pytest.mark.parametrize(
    "said",
    [
        Empty.Response(),
        Trigger.Response(success=True, message="done"),
        answer(ok=True),
        answer(result=Code(result=1)),
        answer(error_code=Code(val=1)),
        CancelGoal.Response(),
        SetParameters.Response(results=[TAKEN, TAKEN]),
        SetParameters.Response(),
        SetParametersAtomically.Response(result=TAKEN),
        # The same names may mean something else.
        answer(ok="no", status=3, result=answer(result=0), return_code=7, results=["a"]),
    ],
)
def test_one_that_says_yes_or_nothing(said):
    assert refusal(said, {}) == ""


def test_what_a_study_expects_counts_in_place_of_what_is_known():
    assert refusal(Trigger.Response(success=False), {"success": False}) == ""
    assert refusal(Trigger.Response(success=True), {"success": False}) == "success is true"
    state = GetState.Response()
    state.current_state.id = 3
    assert refusal(state, {"current_state.id": 3}) == ""
    assert refusal(state, {"current_state.id": 2}) == "current_state.id is 3"
    both = SetParameters.Response(results=[TAKEN, REFUSED])
    assert refusal(both, {"results.successful": True}) == "too high"
    none = SetParameters.Response()
    assert "has 0 items" in refusal(none, {"results[0].successful": True})


@pytest.mark.parametrize("field", ["sucess", "success.done", "status.code"])
def test_a_field_that_answers_do_not_have(field):
    with pytest.raises(StudyError):
        check_expected(Trigger.Response, {field: True})


@pytest.mark.parametrize("expect", [7, {"a b": 1}, {"code": [1]}, {"code": {"val": 1}}])
def test_an_expectation_that_is_none(expect):
    with pytest.raises(StudyError, match="expect"):
        Call(service="/motor/reset", expect=expect)
