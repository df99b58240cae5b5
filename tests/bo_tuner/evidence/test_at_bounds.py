"""Tuned parameters at a bound, and the command that goes on with wider ones."""

import shlex

import pytest
from functions import NODE

from bo_tuner.evidence.at_bounds import at_bounds, wider_options
from bo_tuner.evidence.facts import Said
from bo_tuner.evidence.verdict import State, Verdict
from bo_tuner.evidence.words.next_steps import next_steps
from bo_tuner.evidence.words.verdict import as_mapping, at_bound, sentences

STUDY = {
    "kp": NODE | {"type": "double", "bounds": [0.1, 10.0], "default": 1.0, "unit": "V/rad"},
    "horizon": NODE | {"type": "integer", "bounds": [2, 15], "default": 9},
    "kd": NODE | {"type": "double", "bounds": [0.0, 10.0], "default": 0.1, "scale": "symlog"},
    "weight": NODE | {"type": "double", "bounds": [0.01, 100.0], "default": 1.0, "scale": "log"},
    "offset": NODE | {"type": "double", "bounds": [-1.0, 1.0], "default": 0.0},
    "ki": NODE | {"type": "double", "bounds": [0.0, 8.0], "default": 1.0},
    "taps": NODE | {"type": "integer", "bounds": [1, 10], "step": 4, "default": 5},
    "law": NODE | {"type": "string", "choices": ["a", "b"], "default": "a"},
    "fast": NODE | {"type": "boolean", "default": True},
    "follower": NODE | {"type": "double", "tied_to": "kp"},
}
INSIDE = {"kd": 0.1,
    "kp": 1.0, "horizon": 9, "weight": 1.0, "offset": 0.0, "ki": 1.0, "taps": 5, "law": "b",
    "fast": False,
}  # fmt: skip


def found(make_study, **values):
    study = make_study(parameters=STUDY)
    return at_bounds(study, study.search_space().completed(INSIDE | values))


def test_inside_there_is_nothing_to_tell(make_study):
    assert found(make_study) == ()


@pytest.mark.parametrize(
    ("values", "sentence", "option"),
    [
        ({"kp": 10.0}, "kp is at its upper bound 10 V/rad", "kp=0.1:20"),
        # The range is 9.9, to the resolution of 1e-6 of it.
        ({"kp": 10.0 - 9e-6}, "kp is at its upper bound 10 V/rad", "kp=0.1:20"),
        # A gain keeps its sign.
        ({"kp": 0.1}, "kp is at its lower bound 0.1 V/rad", "kp=0:10"),
        ({"horizon": 15}, "horizon is at its upper bound 15", "horizon=2:28"),
        ({"horizon": 2}, "horizon is at its lower bound 2", "horizon=0:15"),
        # On a log scale by a decade.
        ({"weight": 100.0}, "weight is at its upper bound 100", "weight=0.01:1000"),
        ({"weight": 0.01000009}, "weight is at its lower bound 0.01", "weight=0.001:100"),
        ({"kd": 10.0}, "kd is at its upper bound 10", "kd=0:100"),
        ({"offset": -1.0}, "offset is at its lower bound -1", "offset=-3:1"),
        # 9 is the last one with the step of 4; 10 cannot be reached.
        ({"taps": 9}, "taps is at its upper bound 10", "taps=1:18"),
    ],
)
def test_at_a_bound(make_study, values, sentence, option):
    (bound,) = each = found(make_study, **values)
    assert at_bound(bound) == f"{sentence}; wider bounds may give a better result."
    assert wider_options(each) == f"--bounds {option}"


@pytest.mark.parametrize(
    "values", [{"kp": 10.0 - 2e-5}, {"horizon": 14}, {"weight": 99.0}, {"taps": 5}]
)
def test_close_to_a_bound_is_not_at_it(make_study, values):
    assert found(make_study, **values) == ()


def test_where_the_sign_changes_no_wider_bound_is_proposed(make_study):
    (bound,) = each = found(make_study, ki=0.0)
    assert at_bound(bound) == "ki is at its lower bound 0, where its sign changes."
    assert wider_options(each) == ""


@pytest.mark.parametrize(
    ("lower", "sentence", "options"),
    [
        (3, "horizon is at its lower bound 3; wider bounds", "--bounds horizon=1:12"),
        (1, "horizon is at its lower bound 1, the least of its scale.", ""),
    ],
)
def test_a_whole_number_on_a_log_scale_stays_positive(make_study, lower, sentence, options):
    """As many times less as the range is wide rounds to 0, which a log scale does not have."""
    horizon = NODE | {"type": "integer", "bounds": [lower, 12], "default": 9, "scale": "log"}
    study = make_study(parameters={"horizon": horizon})
    (bound,) = each = at_bounds(study, {"horizon": lower})
    assert at_bound(bound).startswith(sentence)
    assert wider_options(each) == options


@pytest.mark.parametrize(
    "state", [State.VALIDATED, State.UNPROVEN, State.CERTIFIED, State.REFUSED, State.INCOMPLETE]
)
def test_the_verdict_tells_of_it_and_names_the_command(make_study, state):
    each = found(make_study, kp=10.0, ki=8.0, law="a")
    verdict = Verdict(state=state, trial=3, reasons=(Said("why"),), at_bounds=each)
    assert "kp is at its upper bound 10 V/rad" in " ".join(sentences(verdict))
    assert [item["parameter"] for item in as_mapping(verdict)["at_bounds"]] == ["kp", "ki"]
    step = next_steps(verdict, "/my runs/a")[-1]
    assert shlex.split(step.command) == [
        "tune", "--from", "/my runs/a", "--bounds", "kp=0.1:20", "--bounds", "ki=0:16",
    ]  # fmt: skip
