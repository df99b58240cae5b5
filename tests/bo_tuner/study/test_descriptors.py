"""What nodes say of their parameters, in place of a study or against it."""

import copy
import re

import pytest

from bo_tuner.cli.check_times import evaluations_at_most
from bo_tuner.cli.test_runs import plot
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.evidence.certificate.certification import most_evaluations
from bo_tuner.evidence.certificate.plan import Subject
from bo_tuner.evidence.certificate.store import required_draws
from bo_tuner.methods.repetitions import most_check_evaluations
from bo_tuner.study.descriptors import Described, complete, incomplete, node_problems, problem
from bo_tuner.study.parameter import Parameter
from bo_tuner.study.study_file import parse_study

TEXT = """
name: open
nodes:
  pid: {node: pid}
parameters:
  kp: {node: pid}
  rate: {node: pid, parameter: loop.rate}
  mode: {node: pid, choices: [a, b]}
  fast: {node: pid}
  weights: {node: pid, choices: [[1, 2], [3]]}
  "gains[1]": {node: pid, bounds: [0, 9]}
  steps: {node: pid, type: integer, bounds: [1, 5], default: 2}
  frame: {node: pid, fixed: map}
signals: {angle: {topic: a, field: data}}
run: {end: {after: 1.0}}
metrics: {error: {of: angle, measure: iae}}
objective: {metric: error}
budget: {trials: 4, initial_trials: 2, drawn_contexts: 3, validation_draws: 5}
"""
NODE = {
    "kp": Described("double", 0.5, 0.0, 10.0),
    "loop.rate": Described("integer", 30, 10.0, 100.0, 10.0),
    "mode": Described("string", "b"),
    "fast": Described("boolean", True),
    "gains": Described("double_array", [1.0, 2.0]),
    "weights": Described("integer_array", [3]),
    "steps": Described("integer", 3, 1.0, 5.0, 1.0),
    "frame": Described("string", "odom"),
    "locked": Described("double", 1.0, read_only=True),
    "stepped": Described("double", 0.5, 0.0, 2.0, 0.25),
    "odd": Described("double", 0.3, 0.0, 1.0, 0.3),
}


def described(nodes):
    assert nodes == {"pid": "pid"}
    return {"pid": NODE}


def test_what_the_study_leaves_open_comes_from_the_node():
    study = parse_study(TEXT, describe=described)
    found = study.parameters
    assert (found["kp"].type, found["kp"].bounds, found["kp"].default) == ("double", (0, 10), 0.5)
    assert (found["rate"].bounds, found["rate"].step, found["rate"].default) == ((10, 100), 10, 30)
    assert (found["mode"].type, found["mode"].default) == ("string", "b")
    assert (found["fast"].type, found["fast"].default) == ("boolean", True)
    assert (found["weights"].type, found["weights"].default) == ("integer_array", "[3]")
    assert (found["gains[1]"].type, found["gains[1]"].default) == ("double", 2.0)
    assert study.nodes["pid"].parameters["gains"] == (1.0, 2.0)
    # What the study says counts.
    assert found["steps"].default == 2
    assert found["frame"].fixed == "map"


def test_a_whole_study_asks_no_node():
    text = TEXT.replace(
        "kp: {node: pid}", "kp: {node: pid, type: double, bounds: [0, 1], default: 1}"
    )
    for name in ("rate", "mode", "fast", "weights", '"gains', "frame"):
        text = "\n".join(line for line in text.splitlines() if not line.startswith(f"  {name}"))
    parse_study(text, describe=lambda nodes: pytest.fail("asked"))


def test_without_a_node_to_ask_a_study_is_whole():
    with pytest.raises(StudyError, match=r"parameters\.kp\.type: missing"):
        parse_study(TEXT)


def test_no_node_is_asked_whose_name_is_none():
    text = TEXT.replace("pid: {node: pid}", "pid: {node: my-pid}", 1)
    with pytest.raises(StudyError, match=r"nodes\.pid\.node: expected a node name .*'my-pid'"):
        parse_study(text, describe=lambda nodes: pytest.fail("asked"))


@pytest.mark.parametrize(
    ("right", "wrong", "complaint"),
    [
        ("kp: {node: pid}", "kp: {node: pid, bonds: [0, 1]}", "parameters.kp.bonds: unknown key"),
        ("measure: iae", "mesure: iae", "metrics.error.mesure: unknown key"),
        ("objective: {metric: error}", "objective: {metric: eror}", "objective.metric:"),
    ],
)
def test_what_is_wrong_whatever_the_node_says_is_said_before_it_is_asked(right, wrong, complaint):
    """A node that has to be waited for, or is locked by another tuner, hides no misspelt key."""
    with pytest.raises(StudyError, match=re.escape(complaint)):
        parse_study(TEXT.replace(right, wrong), describe=lambda nodes: pytest.fail("asked"))


def test_of_a_node_that_the_study_starts_the_file_has_to_say_it():
    """It need not run, and nobody can be asked for the array of an item."""

    def nobody(nodes):
        raise BackendError("/pid: no such node")

    text = TEXT.replace("pid: {node: pid}", "pid: {node: pid, command: python3 pid.py}", 1)
    with pytest.raises(StudyError, match=r"a study that starts pid has to say .*gains\[1\]"):
        parse_study(text, describe=nobody)
    with pytest.raises(BackendError):
        parse_study(TEXT, describe=nobody)


def test_asking_what_is_open_changes_nothing():
    mapping = {"nodes": {"pid": {"node": "pid"}}, "parameters": {"g[1]": {"node": "pid"}}}
    before = copy.deepcopy(mapping)
    assert incomplete(mapping) == {"pid": ["g[1]"]}
    assert mapping == before


@pytest.mark.parametrize(
    ("item", "complaint"),
    [
        ({"parameter": "kpp"}, "node pid has no parameter 'kpp'; did you mean 'kp'?"),
        ({"parameter": "locked"}, "bounds: missing; node pid gives no range for it"),
        ({"parameter": "gains[0]"}, "bounds: missing; node pid gives no range for it"),
        ({"parameter": "kp[0]"}, "node pid: kp is no array"),
        ({"parameter": "gains[a]"}, "node pid has no parameter 'gains[a]'; did you mean 'gains'?"),
        ({"parameter": "gains[]"}, "node pid has no parameter 'gains[]'; did you mean 'gains'?"),
        (
            {"parameter": "gains[-1]"},
            "node pid has no parameter 'gains[-1]'; did you mean 'gains'?",
        ),
    ],
)
def test_what_no_node_can_say(item, complaint):
    mapping = {"nodes": {"pid": {"node": "pid"}}, "parameters": {"x": {"node": "pid"} | item}}
    with pytest.raises(StudyError) as caught:
        complete(mapping, {"pid": NODE})
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("name", "fields", "expected"),
    [
        ("kp", {"type": "double", "bounds": [0.0, 9.0], "default": 1.0}, ""),
        ("kp", {"type": "double", "bounds": [-1.0, 9.0], "default": 1.0}, "-1 lies outside"),
        ("kp", {"type": "double", "fixed": 11.0}, "11 lies outside the range of 'kp'"),
        ("kp", {"type": "integer", "fixed": 1}, "'kp' is of type double in the node, not integer"),
        ("ki", {"type": "double", "fixed": 1.0}, "the node has no parameter 'ki'"),
        ("locked", {"type": "double", "fixed": 1.0}, "'locked' is read-only in the node"),
        ("gains[1]", {"type": "double", "fixed": 1.0}, ""),
        (
            "gains[1]",
            {"type": "integer", "fixed": 1},
            "type double_array in the node, not",
        ),
        ("loop.rate", {"type": "integer", "bounds": [10, 30], "step": 20, "default": 10}, ""),
        ("loop.rate", {"type": "integer", "fixed": 40}, ""),
        ("odd", {"type": "double", "fixed": 1.0}, ""),
        ("loop.rate", {"type": "integer", "fixed": 45}, "in steps of 10 from 10 on in the node"),
        (
            "loop.rate",
            {"type": "integer", "bounds": [10, 30], "default": 10},
            "in steps of 10 from",
        ),
        (
            "loop.rate",
            {"type": "integer", "bounds": [15, 35], "step": 10, "default": 15},
            "in steps of 10 from 10 on in the node; expected a lower bound and a step that are",
        ),
        ("stepped", {"type": "double", "bounds": [0.5, 2.0], "step": 0.5, "default": 1.0}, ""),
        (
            "stepped",
            {"type": "double", "bounds": [0.5, 2.0], "default": 1.0},
            "steps of 0.25 from 0",
        ),
        (
            "stepped",
            {"type": "double", "bounds": [0.5, 2.0], "step": 0.3, "default": 0.8},
            "in steps of 0.25 from 0 on in the node",
        ),
    ],
)
def test_what_a_node_will_not_take(name, fields, expected):
    item = Parameter(name=name, node="pid", **fields)
    found = problem(item, NODE)
    assert expected in found
    assert bool(found) == bool(expected)


def test_a_step_of_the_node_is_taken_also_beside_bounds_of_the_study():
    text = TEXT.replace("kp: {node: pid}", "stepped: {node: pid, bounds: [0.5, 1.5]}")
    assert parse_study(text, describe=described).parameters["stepped"].step == 0.25


@pytest.mark.parametrize(
    ("section", "described_as", "expected"),
    [
        ("parameters", Described("double", 1.0, 0.0, 5.0), "10 lies outside the range of 'own'"),
        ("contexts", Described("integer", 1), "'own' is of type integer in the node, not double"),
        ("contexts", Described("double", 1.0, read_only=True), "'own' is read-only in the node"),
        ("seed_parameter", Described("double", 1.0), "'own' is of type double in the node, not in"),
        ("seed_parameter", Described("integer", 1, read_only=True), "'own' is read-only in the n"),
    ],
)
def test_what_a_node_will_not_take_besides(section, described_as, expected):
    """A follower has the values of the parameter that it is tied to, between 0 and 10."""
    text = {
        "parameters": TEXT.replace("  rate:", "  own: {node: pid, tied_to: kp}\n  rate:"),
        "contexts": f"{TEXT}contexts:\n  own: {{node: pid, distribution: uniform, bounds: [1, 2], "
        "nominal: 1}\n",
        "seed_parameter": f"{TEXT}seed_parameter: {{node: pid, parameter: own}}\n",
    }[section]
    known = NODE | {"own": described_as}
    study = parse_study(text, describe=lambda nodes: {"pid": known})
    (found,) = node_problems(study, "pid", known, declared=True)
    where = section if section == "seed_parameter" else f"{section}.own"
    assert str(found).startswith(f"{where}: {expected}")


@pytest.mark.parametrize(
    ("type_", "value", "expected"),
    [
        ("double", "3", "'own' is of type double in the node; write 3.0"),
        (
            "double_array",
            "[1, 2]",
            "'own' is of type double_array in the node; write [1.0, 2.0]",
        ),
        ("double", "3.0", None),
        ("integer", "3", None),
        ("boolean", "true", None),
        ("", "3", None),
    ],
)
def test_an_integer_constant_is_no_double(type_, value, expected):
    """A node that has 3.0 already would not be told of it, and one that has 2.0 refuse 3."""
    text = TEXT.replace("{node: pid}\nparam", f"{{node: pid, parameters: {{own: {value}}}}}\nparam")
    study = parse_study(text, describe=described)
    known = NODE | {"own": Described(type_, None)}
    found = [str(error) for error in node_problems(study, "pid", known, declared=True)]
    assert found == ([f"nodes.pid.parameters: {expected}"] if expected else [])


def test_a_plot_holds_each_value_until_the_next():
    assert plot([0.0, 1.0], [0.0, 7.0], 2.0, width=4) == "▁▁██"
    assert plot([0.0], [3.0], 2.0, width=4) == plot([0.0], [5.0], 2.0, width=4)
    assert plot([0.0, 1.0], [0.0, float("nan")], 2.0) == "not finite"


LIMIT = """
contexts: {load: {node: pid, parameter: load, distribution: uniform, bounds: [1, 2]}}
constraints: {error: {kind: worst_case, metric: error, upper: 1.0, probability: 0.9}}
"""


def test_the_runs_of_a_study_are_counted():
    """Two trials of three runs, two of one at the boundary, the check of an answer, and so on."""
    study = parse_study(TEXT, describe=described)
    assert evaluations_at_most(study) == (2 * 3 + 2 * 1 + most_check_evaluations(study) + 10, 1000)


def test_the_certificate_of_a_worst_case_limit_counts_its_search_and_repetitions():
    study = parse_study(TEXT + LIMIT, describe=described)
    subject = Subject("tuned", study.search_space().defaults, ({"load": 2.0},))
    draws = required_draws(study, study.certificate.confidence)
    most = most_evaluations(study, [subject], draws)
    assert evaluations_at_most(study)[1] == most.total == draws + most.searched + most.repeated
    assert min(most.searched, most.repeated) > 0
