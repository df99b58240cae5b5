"""A study with parameters that are kept at a value."""

import pytest

from bo_tuner.cli import tune
from bo_tuner.cli.study_options import changed_study
from bo_tuner.errors import StudyError

NODE = {"node": "axis", "type": "double", "bounds": [0.1, 10.0]}
PARAMETERS = {
    "kp": NODE | {"default": 1.0, "scale": "log"},
    "ki": NODE | {"default": 1.0},
    "follower": {"node": "axis", "type": "double", "tied_to": "kp"},
}


def fixed(make_study, *options, **sections):
    study = make_study(parameters=PARAMETERS, **sections)
    arguments = tune.make_parser().parse_args([each for o in options for each in ("--fix", o)])
    return changed_study(study, arguments, "")


def test_it_has_the_value_in_every_trial(make_study):
    study = fixed(make_study, "kp=2", start=["default", {"kp": 3.0, "ki": 0.5}])
    space = study.search_space()
    assert space.names == ("ki",)
    assert space.completed({"ki": 0.3}) == {"kp": 2.0, "ki": 0.3, "follower": 2.0}
    assert study.starting_sets() == [
        {"kp": 2.0, "ki": 1.0, "follower": 2.0},
        {"kp": 2.0, "ki": 0.5, "follower": 2.0},
    ]


def test_it_is_safe_with_the_value(make_study):
    study = fixed(make_study, "kp=2", park={"parameters": {"kp": 0.5, "ki": 0.2}})
    assert study.safe_parameters == {"kp": 2.0, "ki": 0.2, "follower": 2.0}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["kq=2"], "--fix: there is no parameter 'kq'; expected one of kp, ki, follower"),
        (["follower=2"], "--fix: follower: is not tuned"),
        (["kp=20"], "--fix: kp: 20 lies outside the bounds (0.1, 10.0)"),
        (["kp=high"], "--fix: kp: expected a number, found text 'high'"),
        (["kp=2", "kp=3"], "--fix: kp has more than one; leave all but one out"),
        (["kp=2", "ki=3"], "--fix: parameters: no parameter is tuned; give one bounds"),
    ],
)
def test_what_cannot_be(make_study, options, said):
    with pytest.raises(StudyError) as caught:
        fixed(make_study, *options)
    assert str(caught.value) == said


@pytest.mark.parametrize("text", ["kp", "=2", "kp="])
def test_what_says_nothing(text, capsys):
    with pytest.raises(SystemExit) as caught:
        tune.make_parser().parse_args(["--fix", text])
    assert caught.value.code == 2
    assert f"argument --fix: {text}: expected NAME=VALUE, such as kp=2.0" in capsys.readouterr().err
