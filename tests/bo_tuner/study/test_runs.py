"""Studies of systems that know nothing of the tuner: signals, their metrics, and runs."""

import pytest
from drive_text import refusal

from bo_tuner.errors import StudyError
from bo_tuner.study import strict_yaml
from bo_tuner.study.fields import FieldPart, field_path
from bo_tuner.study.metrics import SignalMetric
from bo_tuner.study.publishing import Publish
from bo_tuner.study.resting import Rest, WarmUp
from bo_tuner.study.run import End
from bo_tuner.study.steps import Call, Step
from bo_tuner.study.study_file import parse_study, study_from_mapping, study_to_yaml

STUDY = """\
name: position
nodes:
  pid: {node: pid}
parameters:
  kp: {node: pid, type: double, bounds: [1.0, 50.0], default: 5.0}
signals:
  setpoint: {topic: /setpoint, field: data, minimum_messages: 0}
  position: {topic: joint_states, field: "position[motor]", time: header, largest_gap: 1}
run:
  before:
    - call: {service: /motor/reset}
    - publish: {topic: /setpoint, type: std_msgs/msg/Float64, message: {data: 0.0}}
    - wait: 1
  start:
    - publish: {topic: /setpoint, message: {data: 1.0}}
  end: {after: 2}
  timeout: 5
  abort_when: abs(position) > 3 and t > 0.1
metrics:
  error: {of: setpoint - position, measure: iae, unit: rad s}
  settling: {of: position, measure: settling_time, target: setpoint, band: 0.05}
  effort: {of: abs(position), measure: percentile, percent: 95}
objective: {metric: error}
budget: {trials: 12, initial_trials: 4}
"""
ALL_STEPS = [
    {"call": {"service": "/a", "timeout": 2.0}},
    {"publish": {"topic": "/a", "message": {"data": 1}}},
    {"send_goal": {"action": "/a", "goal": {"order": 1}, "timeout": 2.0}},
    {"lifecycle": {"node": "/a", "transition": "activate"}},
    {"restart": "pid"},
    {"wait_until": {"condition": "abs(position) < 0.1", "hold": 0.5, "timeout": 5.0}},
    {"wait": 1.0},
]


def put(value, *path):
    """The study with a value put in; None takes the key out."""
    changed = inner = strict_yaml.parse(STUDY).value
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return changed


@pytest.mark.parametrize(("short", "name"), [("min", "minimum"), ("max", "maximum")])
def test_a_measure_by_another_name_is_the_same(short, name):
    metrics = [SignalMetric(name="m", of="x", measure=word) for word in (short, name)]
    assert metrics[0] == metrics[1]


def test_what_is_read():
    study = parse_study(STUDY)
    assert study.nodes["pid"].result == ""
    assert study.trigger is None
    assert study.signals["position"].largest_gap == 1.0
    reset, home, wait = study.run.before
    assert reset == Step(call=Call(service="/motor/reset"))
    assert home.publish == Publish(
        topic="/setpoint", type="std_msgs/msg/Float64", message={"data": 0.0}
    )
    assert wait == Step(wait=1.0)
    assert (study.run.end, study.run.after) == (End(after=2.0), ())
    assert study.metrics["settling"].target == "setpoint"
    assert [path for path, _ in study.run.steps][-1] == ("run", "start", 0)


def test_what_is_written_reads_back_equal():
    study = parse_study(STUDY)
    assert parse_study(study_to_yaml(study)) == study
    lists = {"topic": "a", "message": {"points": [{"x": [1.0, 2.0], "name": "b"}], "on": True}}
    nested = study_from_mapping(put([{"publish": lists}], "run", "after"))
    assert parse_study(study_to_yaml(nested)) == nested


@pytest.mark.parametrize(
    ("key", "short", "expected"),
    [
        ("warm_up", 3, WarmUp(runs=3, after=600.0)),
        ("warm_up", {"runs": 3, "after": 60}, WarmUp(runs=3, after=60.0)),
        ("rest", 30, Rest(at_least=30.0)),
        ("rest", {"until": "position < 1"}, Rest(until="position < 1", at_most=600.0)),
        ("ramp", 3, 3.0),
    ],
)
def test_warm_up_rest_and_ramp(key, short, expected):
    study = study_from_mapping(put(short, "run", key))
    assert getattr(study.run, key) == expected
    assert parse_study(study_to_yaml(study)) == study


def test_a_tuned_node_is_not_configured_with_its_safe_parameters():
    """It would read them then, and keep them in the run."""
    configure = {"lifecycle": {"node": "/pid", "transition": "configure"}}
    parked = put([configure], "run", "before") | {"park": {"between_runs": True}}
    with pytest.raises(StudyError, match=r"^park\.between_runs: a step of run\.before"):
        study_from_mapping(parked)
    manager = "/controller_manager"
    switch = {
        "service": f"{manager}/switch_controller",
        "request": {"activate_controllers": ["pid"]},
    }
    for call in (
        switch,
        {"service": f"{manager}/configure_controller", "request": {"name": "pid"}},
        {"service": "/pid/change_state", "request": {"transition": {"id": 1}}},
    ):
        with pytest.raises(StudyError, match=r"configures pid, which has the safe parameters"):
            study_from_mapping(parked | put([{"call": call}], "run", "before"))
    astray = put([configure], "run", "before") | {"park": {"between_runs": True}}
    astray["parameters"]["kp"]["node"] = "pdi"
    with pytest.raises(StudyError, match="there is no node 'pdi'"):
        study_from_mapping(astray)
    other = {"lifecycle": {"node": "/camera", "transition": "configure"}}
    reset = {"call": {"service": "/pid/reset"}}
    elsewhere = {"call": switch | {"request": {"activate_controllers": ["arm"]}}}
    for allowed in (
        put([configure], "run", "before"),
        put([reset, elsewhere], "run", "before") | {"park": {"between_runs": True}},
        put([other], "run", "before") | {"park": {"between_runs": True}},
    ):
        study_from_mapping(allowed)


def test_all_steps_and_sections_are_written_and_read_back():
    changed = put(ALL_STEPS, "run", "recover")
    changed["run"] |= {"start": [{"send_goal": {"action": "/go"}}], "end": "result", "clock": "sim"}
    changed["park"] = {"parameters": {"kp": 2.0}, "between_runs": True}
    changed["nodes"]["pid"] |= {"command": "python pid.py", "env": {"A": "b"}}
    changed["signals"]["position"]["most_lost"] = 3
    changed["metrics"]["own"] = {"python": "my_metrics:jerk"}
    study = study_from_mapping(changed)
    assert study.run.end == End(result=True)
    assert study.safe_parameters == {"kp": 2.0}
    assert parse_study(study_to_yaml(study)) == study


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("data", [FieldPart("data")]),
        ("data[3]", [FieldPart("data", 3)]),
        ("position[motor]", [FieldPart("position", "motor")]),
        ("position[left.wheel-1]", [FieldPart("position", "left.wheel-1")]),
        ("pose.pose.position.x", [FieldPart(n) for n in ("pose", "pose", "position", "x")]),
        ("points[0].positions[2]", [FieldPart("points", 0), FieldPart("positions", 2)]),
    ],
)
def test_paths_of_fields(text, expected):
    assert list(field_path(text)) == expected


@pytest.mark.parametrize(
    "text", ["", "[3]", "a..b", "a[", "a[]", "a[1][2]", "a b", "/a", "_a", "é"]
)
def test_no_path_of_a_field(text):
    with pytest.raises(StudyError, match="expected a field such as"):
        field_path(text)


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        ("run", None, "trigger: missing; expected trigger, or run with signals"),
        ("trigger", {"node": "pid", "service": "~/go"}, "run: a study has either trigger or run"),
        ("signals/position/topic", "~/state", "expected a topic name such as /joint_states"),
        ("signals/position/topic", None, "signals.position.topic: missing"),
        ("signals/position/field", "position motor", "expected a field such as"),
        ("signals/position/type", "JointState", "expected a message type such as"),
        ("signals/position/time", "haeder", "unknown 'haeder'; did you mean 'header'?"),
        ("signals/position/minimum_messages", -1, "expected an integer of at least 0"),
        ("signals/position/largest_gap", 0, "expected a number above 0"),
        ("signals/position/filed", "x", "unknown key; did you mean 'field'?"),
        ("signals/t", {"topic": "a", "field": "b"}, "signals.t: 't' has a meaning in expressions"),
        ("signals/abs", {"topic": "a", "field": "b"}, "'abs' has a meaning in expressions"),
        ("signals/in", {"topic": "a", "field": "b"}, "'in' has a meaning in expressions"),
        ("signals/lambda", {"topic": "a", "field": "b"}, "'lambda' has a meaning in expressions"),
        ("signals/a-b", {"topic": "a", "field": "b"}, "expected a name of letters, digits and _"),
        ("metrics/error/of", "setpoint - positoin", "there is no signal or function 'positoin'; "
         "did you mean 'position'?"),
        ("metrics/error/of", "cosh(position)", "there is no signal or function 'cosh'"),
        ("metrics/error/of", "position.real", "metrics.error.of: Sorry, Attribute is not"),
        ("metrics/error/of", "t + 1", "expected an expression with a signal"),
        ("metrics/error/of", 3, "metrics.error.of: expected text, found 3"),
        ("metrics/error/of", None, "metrics.error.of: missing"),
        ("metrics/error/measure", "settle_time", "did you mean 'settling_time'?"),
        ("metrics/error/measure", "percentile", "metrics.error.percent: missing; percentile needs"),
        ("metrics/error/measure", "largest_rate", "expected one signal"),
        ("metrics/error/target", 1.0, "metrics.error.target: iae has none"),
        ("metrics/error/key", "x", "metrics.error.key: unknown key"),
        ("metrics/settling/target", "stepoint", "did you mean 'setpoint'?"),
        ("metrics/settling/target", [1], "settling.target: expected a number, text, found a list"),
        ("metrics/settling/band", 0, "expected a number above 0"),
        ("metrics/effort/percent", 101, "metrics.effort.percent: expected 0 to 100, found 101"),
        ("metrics/other", {"node": "pid"}, "metrics.other.node: is reported by a node that"),
        ("run/end", None, "run.end: missing"),
        ("run/end/when", "position > 1", "run.end: expected one of after, when, result and played"),
        ("run/end/after", 6, "run.end.after: 6 s are more than the timeout, 5 s"),
        ("run/end/after", None, "run.end: expected one of after, when, result and played"),
        ("run/timeout", 0, "run.timeout: expected a number above 0"),
        ("run/abort_when", "positon > 1", "abort_when: there is no signal or function 'positon'"),
        ("run/timeout", 1e5, "run.timeout: expected a number above 0 and at most 86400 s"),
        ("run/before", [{"wait": 1}] * 101, "run.before: expected at most 100 entries, found 101"),
        ("signals", {f"s{k}": {"topic": "a", "field": "b"} for k in range(101)}, "at most 100 e"),
        ("run/abort_when", "position >", "run.abort_when: not an expression: something is missing "
         "at its end, in 'position >'"),
        ("run/end", "results", "run.end: expected result, played, or a mapping such as "
         "{after: 2.0}; did you mean 'result'?"),
        ("run/end", 2.0, "run.end: expected result, played, or a mapping such as "
         "{after: 2.0}; found 2.0"),
        ("run/abort_wen", "position > 1", "unknown key; did you mean 'abort_when'?"),
        ("run/before", {"wait": 1}, "run.before: expected a list of steps, found a mapping"),
        ("run/before/2/wait", -1, "run.before[2].wait: expected a number above 0"),
        ("run/before/2/call", {"service": "/a"}, "run.before[2]: expected one of call, publish"),
        ("run/before/0/call/service", "/a b", "before[0].call.service: expected a service name"),
        ("run/before/0/cal", 1, "run.before[0].cal: unknown key; did you mean 'call'?"),
        ("run/before/1/publish/message", [1], "run.before[1].publish.message: expected the fields"),
        ("run/before/1/publish/message/data", {"x": "?", "y": {}}, None),
        ("run/before/1/publish/type", "Float64", "expected a message type"),
        ("run/before/2/wait_until", {"condition": "position < 1"}, "expected one of call, publish"),
        ("run/recover", [{"wait_until": {"condition": "positon < 1"}}],
         "run.recover[0].wait_until.condition: there is no signal or function 'positon'"),
        ("run/recover", [{"wait_until": {"condition": "t > 1", "hold": 3, "timeout": 2}}],
         "run.recover[0].wait_until.hold: 3 s are more than the timeout, 2 s"),
        ("run/recover", [{"wait_until": {"timeout": 2}}], "wait_until.condition: missing"),
        ("run/after", [{"lifecycle": {"node": "pid", "transition": "actvate"}}],
         "run.after[0].lifecycle.transition: unknown 'actvate'; did you mean 'activate'?"),
        ("run/after", [{"restart": "pdi"}], "run.after[0].restart: there is no node 'pdi'"),
        ("run/after", [{"restart": "pid"}], None),
        ("run/after", [{"restart": ["pid", "pdi"]}], "run.after[0].restart: there is no node"),
        ("run/after", [{"restart": []}], "run.after[0].restart: expected a node, or a list of"),
        ("run/start", [{"restart": ["pid"]}], "run.start[0].restart: a node that restarts in"),
        ("run/start", [{"restart": "pid"}], "run.start[0].restart: a node that restarts in a run"),
        ("run/start", [{"send_goal": {"action": "a b"}}], "send_goal.action: expected an action"),
        ("run/end", "result", "run.end.result: start has no send_goal"),
        ("run/end", {"result": 1}, "run.end.result: expected true or false, found 1"),
        ("run/clock", "simulated", "run.clock: unknown 'simulated'; expected one of wall, sim"),
        ("run/warm_up", 0, "run.warm_up.runs: expected an integer of at least 1, found 0"),
        ("run/warm_up", 1001, "run.warm_up.runs: expected an integer of at most 1000, found"),
        ("run/warm_up", True, "run.warm_up: expected a number of runs, or a mapping of them"),
        ("run/warm_up", {"after": 60}, "run.warm_up.runs: missing"),
        ("run/warm_up", {"runs": 1, "after": 0}, "run.warm_up.after: expected a number above 0"),
        ("run/rest", 0, "run.rest: expected at_least above 0, until, or both"),
        ("run/rest", 1e5, "run.rest.at_least: expected 0 to 86400 s, found 100000.0"),
        ("run/rest", "30 s", "run.rest: expected a time [s], or a mapping of the rest"),
        ("run/rest", {}, "run.rest: expected at_least above 0, until, or both"),
        ("run/rest", {"at_least": -1}, "run.rest.at_least: expected 0 to 86400 s, found -1"),
        ("run/rest", {"until": "positon < 1"}, "run.rest.until: there is no signal or function"),
        ("run/rest", {"until": "position < {kp}"}, "run.rest.until: expected no name in braces"),
        ("run/rest", {"until": "position < 1", "at_most": 0}, "run.rest.at_most: expected a numb"),
        ("run/rest", {"untill": "position < 1"}, "unknown key; did you mean 'until'?"),
        ("run/ramp", 0.2, None),
        ("run/ramp", 0, "run.ramp: expected 0.2 to 60 s, found 0"),
        ("run/ramp", 61, "run.ramp: expected 0.2 to 60 s, found 61"),
        ("run/ramp", "3 s", "run.ramp: expected a number, found text '3 s'"),
        ("run/ramp", True, "run.ramp: expected a number, found true"),
        ("run/ramp", {"seconds": 3}, "run.ramp: expected a number, found a mapping"),
        ("park", {"parameters": {"kd": 1}}, "park.parameters: there is no parameter 'kd'"),
        ("park", {"parameters": {"kp": 60}}, "park.parameters: kp: 60 lies outside the bounds"),
        ("park", {"parameters": {"kp": "soft"}}, "park.parameters: kp: expected a number, found"),
        ("park", {"parameters": [1]}, "park.parameters: expected values by parameter, found a"),
        ("park", {"between_runs": "yes"}, "park.between_runs: expected true or false, found"),
        ("park", {"betwen_runs": True}, "unknown key; did you mean 'between_runs'?"),
        ("signals/position/most_lost", -1, "most_lost: expected an integer of at least 0"),
        ("metrics/own", {"python": "my_metrics"}, "metrics.own.python: expected module:function"),
        ("metrics/own", {"python": "a:b", "of": "x"}, "unknown key"),
        ("nodes/pid/command", "a 'b", "nodes.pid.command: expected words as in a shell: No clos"),
        ("nodes/pid/command", "", "nodes.pid.command: expected a program"),
        ("nodes/pid/env", {"A": "b"}, "nodes.pid.env: belongs to a node that is started"),
        ("nodes/pid", {"node": "pid", "command": "a", "launch": "b c"},
         "nodes.pid.launch: command starts the node already; leave one out"),
        ("nodes/pid", {"node": "pid", "command": "a", "env": {"A": 1}},
         "nodes.pid.env.A: expected text, found 1"),
        ("nodes/pid", {"node": "pid", "command": "a", "env": {"A=B": "1"}},
         "nodes.pid.env: expected the name of a variable"),
        ("run/start", [{"wait": 3}], "run.start: the steps take 3 s, but the run ends after 2 s"),
    ],
)  # fmt: skip
def test_mistakes(path, value, complaint):
    keys = [int(key) if key.isdigit() else key for key in path.split("/")]
    if complaint is None:
        study_from_mapping(put(value, *keys))
    else:
        assert complaint in refusal(put(value, *keys))


def test_an_error_has_its_line():
    with pytest.raises(StudyError) as caught:
        parse_study(STUDY.replace("abs(position) > 3", "abs(postion) > 3"), "study.yaml")
    assert str(caught.value).startswith("study.yaml:18: run.abort_when: there is no signal")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"signals": {"x": {"topic": "x", "field": "data"}}}, "signals: signals are recorded in a"),
        ({"metrics": {"error": {"of": "x", "measure": "iae"}}}, "metrics.error: signals are"),
        ({"nodes": {"axis": {"node": "axis"}}}, "nodes.axis.result: missing; the trigger needs it"),
        ({"trigger": None}, "trigger: missing; expected trigger, or run with signals"),
    ],
)  # fmt: skip
def test_mistakes_of_a_study_with_a_trigger(make_study, changes, complaint):
    with pytest.raises(StudyError) as caught:
        make_study(**({"metrics": {"error": {"node": "axis"}}, "constraints": {}} | changes))
    assert str(caught.value).startswith(complaint)
