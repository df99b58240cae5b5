"""What is tried before the initial design: the default, and what the user knows."""

import pytest

from bo_tuner.errors import StudyError
from bo_tuner.method_names import SAFE
from bo_tuner.methods.registry import METHODS
from bo_tuner.study.study_file import load_study, parse_study, study_to_yaml

NODE = {"node": "axis"}
PARAMETERS = {
    "gain": NODE | {"type": "double", "bounds": [0.0, 1.0], "default": 0.5},
    "twin": NODE | {"type": "double", "tied_to": "gain"},
    "steps": NODE | {"type": "integer", "bounds": [1, 4], "default": 2},
}
DEFAULT = {"gain": 0.5, "twin": 0.5, "steps": 2}


def proposals(study, make_trial, count, algorithm="IV"):
    optimizer = METHODS[algorithm].optimizer(study)
    found = []
    for number in range(count):
        found.append(optimizer.ask())
        optimizer.tell(make_trial(number, found[-1].parameters, [1.0, 1.1], 0.5))
    return found


@pytest.mark.parametrize("algorithm", METHODS)
def test_the_default_comes_first(make_study, make_trial, algorithm):
    """Unless the study says otherwise, whatever the algorithm."""
    study = make_study(parameters=PARAMETERS, start=None)
    found = proposals(study, make_trial, 3, algorithm)
    then = "expansion" if algorithm == SAFE else "initial"
    assert [p.origin for p in found] == ["default", then, then]
    assert found[0].parameters == DEFAULT
    assert len({tuple(p.parameters.values()) for p in found}) == 3


def test_known_sets_follow_each_once(make_study, make_trial):
    known = [{"gain": 0.25}, {"steps": 4}, "default", {"gain": 0.25, "steps": 2}]
    study = make_study(parameters=PARAMETERS, start=["default", *known])
    found = proposals(study, make_trial, 4)
    assert [p.origin for p in found] == ["default", "start", "start", "acquisition"]
    assert [p.parameters for p in found[1:3]] == [
        {"gain": 0.25, "twin": 0.25, "steps": 2},
        DEFAULT | {"steps": 4},
    ]


@pytest.mark.parametrize("name", ["benchmark", "full"])
def test_the_studies_of_the_paper_begin_with_its_design(name):
    study = load_study(name)
    first = METHODS["IV"].optimizer(study).ask()
    assert first.origin == "initial"
    assert first.parameters != study.search_space().defaults


@pytest.mark.parametrize("start", [[], ["default"], ["default", {"gain": 0.25}], [{"steps": 3}]])
def test_a_study_file_keeps_what_comes_first(make_study, start):
    study = make_study(parameters=PARAMETERS, start=start)
    assert parse_study(study_to_yaml(study)).start == study.start


@pytest.mark.parametrize(
    ("start", "problem"),
    [
        ("default", "start: expected a list of parameter sets, or default, found text 'default'"),
        (["tuned"], "start[0]: expected parameter sets, or default, found text 'tuned'"),
        ([{"gian": 0.1}], "start[0]: gian: unknown parameter; did you mean 'gain'?"),
        ([{"gain": 2.0}], "start[0]: gain: 2.0 lies outside the bounds (0.0, 1.0)"),
        ([{"steps": 1.5}], "start[0]: steps: expected an integer, found 1.5"),
        ([{"twin": 0.1}], "start[0].twin: expected 0.5, as the study sets it, found 0.1"),
        ([{"steps": n} for n in (1, 2, 3, 4)] * 2 + [{"gain": 0.1}, {"gain": 0.2}], "6 parameter"),
    ],
)
def test_sets_that_are_not_of_the_study(make_study, start, problem):
    with pytest.raises(StudyError) as caught:
        make_study(parameters=PARAMETERS, start=start)
    assert problem in str(caught.value)


def test_sets_in_the_wrong_order(make_study):
    parameters = PARAMETERS | {"most": PARAMETERS["steps"]}
    with pytest.raises(StudyError, match="expected 'steps' <= 'most', found 3 and 2"):
        make_study(parameters=parameters, order=[["steps", "most"]], start=[{"steps": 3}])


@pytest.mark.parametrize(
    ("lower", "default", "proposal"),
    [(0.0, 0.5, "[0.0005, 10.0]"), (0, 5, "[1, 10]")],
)
def test_a_log_scale_from_zero_on_gets_a_proposal(make_study, lower, default, proposal):
    kind = "integer" if isinstance(lower, int) else "double"
    item = NODE | {"type": kind, "bounds": [lower, 10], "default": default, "scale": "log"}
    with pytest.raises(StudyError) as caught:
        make_study(parameters={"gain": item})
    assert f"write bounds: {proposal}, or scale: symlog" in str(caught.value)
