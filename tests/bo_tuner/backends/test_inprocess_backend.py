"""Evaluations on objects of this process: foreign code may do what it likes, the run goes on."""

import signal
import sys

import pytest
from functions import planned

from bo_tuner.backends.inprocess import InProcessBackend
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.study.study_file import load_study
from bo_tuner.trials import EvaluationState

OBJECTS = '''\
import os
import signal
import sys


class Wild:
    def __float__(self):
        raise ZeroDivisionError("of its own")

    def __str__(self):
        raise ZeroDivisionError("of its own")


class Axis:
    def __init__(self):
        self.values = {}

    def set_parameters(self, values):
        for name in ("gain", "limit"):
            if values.get(name, 0.0) > 0.9:
                raise ValueError(f"{name}: {values[name]} is above 0.9")
            if values.get(name, 0.0) < 0.0:
                raise TypeError("no sign")
        self.values.update(values)

    def evaluate(self, *others):
        said = {"status": "ok", "reason": "", "error": self.values.get("gain", 0.5), "peak": 1.0}
        said["told"] = repr(sorted(self.values.items()))
        behaviour = self.values.get("behaviour", "")
        if behaviour == "raise":
            raise RuntimeError("motor on fire")
        if behaviour == "nothing":
            return None
        if behaviour == "leave":
            sys.exit(0)
        if behaviour == "stop":
            raise KeyboardInterrupt
        if behaviour == "move":
            os.chdir("/")
        elif behaviour == "wild":
            said["error"] = Wild()
        elif behaviour == "signal":
            os.kill(os.getpid(), signal.SIGUSR1)
            while True:
                try:
                    pass
                except Exception:
                    pass
        elif behaviour:
            said |= eval(behaviour)
        return said


class Sensor(Axis):
    """Gives the peak in place of the axis."""

    def result(self):
        return Axis.evaluate(self)


class Outer:
    class Inner(Axis):
        pass


class Broken:
    def __init__(self):
        raise OSError("no such bus\\nline two")


class Bare:
    pass


number = 3
'''

NODE = {"node": "axis", "result": "~/cut_result", "object": "axis_objects:Axis"}
PLANNED = planned({"gain": 0.25}, {"load": 1.5}, 3)


@pytest.fixture
def opened(tmp_path, monkeypatch, make_study):
    """Function that opens a backend on the objects above."""
    (tmp_path / "axis_objects.py").write_text(OBJECTS)
    (tmp_path / "no_python.py").write_text("class Axis(:\n")
    monkeypatch.syspath_prepend(tmp_path)
    # Other tests have a module of this name, too.
    monkeypatch.delitem(sys.modules, "axis_objects", raising=False)

    def make(interrupted=lambda: None, **sections):
        backend = InProcessBackend(make_study(**sections), interrupted)
        backend.open()
        return backend

    return make


def behaving(opened, behaviour, interrupted=lambda: None):
    return opened(interrupted, nodes={"axis": NODE | {"parameters": {"behaviour": behaviour}}})


class TestOpen:
    @pytest.mark.parametrize(
        ("path", "complaint"),
        [
            (None, "no object; expected module:Class"),
            ("no_such_module:Axis", "No module named 'no_such_module'"),
            ("axis_objects:Nothing", "has no attribute 'Nothing'"),
            ("axis_objects:number", "'int' object is not callable"),
            ("axis_objects:Broken", "OSError: no such bus"),
            ("no_python:Axis", "SyntaxError"),
        ],
    )
    def test_an_object_that_cannot_be_had(self, opened, path, complaint):
        node = {key: value for key, value in (NODE | {"object": path}).items() if value}
        with pytest.raises(StudyError, match=complaint) as caught:
            opened(nodes={"axis": node})
        assert str(caught.value).startswith("nodes.axis.object: ")

    @pytest.mark.parametrize(
        ("node", "complaint"),
        [
            ({"parameters": {"limit": 0.95}}, "limit: 0.95 is above 0.9"),
            ({"parameters": {"limit": -1.0}}, "TypeError"),
            ({"object": "axis_objects:Bare"}, "AttributeError"),
        ],
    )
    def test_constants_that_are_refused(self, opened, node, complaint):
        with pytest.raises(StudyError, match=complaint) as caught:
            opened(nodes={"axis": NODE | node})
        assert str(caught.value).startswith("nodes.axis.parameters: ")

    def test_constants_of_the_backend_win(self, opened):
        node = NODE | {"parameters": {"a": 1, "b": 2}, "inprocess_parameters": {"b": 3}}
        told = opened(nodes={"axis": node}).outcome(PLANNED).details["axis.told"]
        assert told == repr([("a", 1), ("b", 3), ("gain", 0.25), ("load", 1.5), ("seed", 3)])

    def test_a_nested_class(self, opened):
        backend = opened(nodes={"axis": NODE | {"object": "axis_objects:Outer.Inner"}})
        assert backend.outcome(PLANNED).state is EvaluationState.COMPLETE

    def test_not_open(self, opened):
        backend = opened()
        backend.close()
        backend.close()
        with pytest.raises(BackendError):
            backend.outcome(PLANNED)


class TestEvaluation:
    def test_metrics(self, opened):
        found = opened().outcome(PLANNED)
        assert found.state is EvaluationState.COMPLETE
        assert found.metrics == {"error": 0.25, "peak": 1.0}

    @pytest.mark.parametrize(
        ("gain", "reason"),
        [
            (0.95, "axis refused its parameters: gain: 0.95 is above 0.9"),
            (-1.0, "axis refused its parameters: TypeError: no sign"),
        ],
    )
    def test_refused_parameters(self, opened, gain, reason):
        backend = opened()
        found = backend.outcome(planned({"gain": gain}, {"load": 1.5}, 3))
        assert found.state is EvaluationState.FAILED
        assert found.reason == reason
        assert backend.outcome(PLANNED).state is EvaluationState.COMPLETE

    @pytest.mark.parametrize(
        ("behaviour", "reason"),
        [
            ("raise", "RuntimeError: motor on fire"),
            ("nothing", "axis: answered NoneType; expected a mapping"),
            ("{'status': 'failed', 'reason': 'stalled'}", "axis: stalled"),
            ("{'error': float('nan')}", "axis: metric error is nan"),
            ("{'error': None}", "axis: metric error is"),
            ("{'peak': 'inf'}", "axis: metric peak is inf"),
            ("leave", "SystemExit: 0"),
            ("stop", "KeyboardInterrupt"),
            ("move", "MovedError: changed the working directory to /"),
            ("wild", "axis: metric error is a Wild that is no number: ZeroDivisionError: of its"),
        ],
    )
    def test_a_failed_evaluation_has_its_reason(self, opened, handlers, behaviour, reason):
        Interruption()
        found = behaving(opened, behaviour).outcome(PLANNED)
        assert found.state is EvaluationState.FAILED
        assert reason in found.reason
        assert found.metrics == {}

    def test_a_signal_ends_an_object_at_work(self, opened, handlers):
        """Which does not look for one; afterwards signals are for the run to notice again."""
        interruption = Interruption()
        backend = behaving(opened, "signal", interruption.check)
        with pytest.raises(Interrupted):
            backend.outcome(PLANNED)
        signal.raise_signal(signal.SIGTERM)
        assert interruption.signum == signal.SIGTERM

    def test_ctrl_c_without_a_command_is_no_fault_of_the_object(self, opened):
        # A shell that starts the tests in the background has them ignore it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with pytest.raises(KeyboardInterrupt):
            behaving(opened, "stop").outcome(PLANNED)

    def sensing(self, opened, behaviour):
        sensor = NODE | {
            "node": "sensor",
            "object": "axis_objects:Sensor",
            "parameters": {"behaviour": behaviour},
        }
        metrics = {"error": {"node": "axis"}, "peak": {"node": "sensor"}}
        return opened(nodes={"axis": NODE, "sensor": sensor}, metrics=metrics)

    def test_metrics_of_another_node(self, opened):
        found = self.sensing(opened, "{'peak': 7.0}").outcome(PLANNED)
        assert found.metrics == {"error": 0.25, "peak": 7.0}

    @pytest.mark.parametrize(
        ("behaviour", "reason"),
        [
            ("raise", "RuntimeError: motor on fire"),
            ("nothing", "sensor: answered NoneType; expected a mapping"),
            ("{'status': 'failed', 'reason': 'blind'}", "sensor: blind"),
        ],
    )
    def test_another_node_fails(self, opened, behaviour, reason):
        found = self.sensing(opened, behaviour).outcome(PLANNED)
        assert found.state is EvaluationState.FAILED
        assert reason in found.reason


class TestBatch:
    def test_results_come_one_by_one_in_the_order_given(self, make_study, function_backend):
        backend = function_backend(make_study(), lambda gain, **_: {"error": gain, "peak": 0.0})
        batch = [planned({"gain": gain}, {"load": 1.5}) for gain in (0.25, 0.5, 0.75)]
        results = backend.run(iter(batch))
        assert backend.calls == []
        assert next(results).outcome.metrics["error"] == 0.25
        assert len(backend.calls) == 1
        assert [result.parameters["gain"] for result in results] == [0.5, 0.75]


class TestMilling:
    """The shipped study on its own objects."""

    def evaluation(self, backend, **changes):
        study = load_study("benchmark")
        context = {"stiffness_factor": 1.0, "damping_factor": 1.0}
        parameters = study.search_space().defaults | changes
        return backend.outcome(planned(parameters, context, 5))

    @pytest.fixture
    def backend(self):
        backend = InProcessBackend(load_study("benchmark"))
        backend.open()
        return backend

    def test_an_evaluation_depends_on_nothing_before_it(self, backend):
        first = self.evaluation(backend)
        assert first.state is EvaluationState.COMPLETE
        self.evaluation(backend, lambda_mpc=-1.0)
        assert self.evaluation(backend) == first

    def test_a_refusal_leaves_the_next_evaluation_untouched(self, backend):
        first = self.evaluation(backend)
        refused = self.evaluation(backend, control_horizon=20, prediction_horizon=10)
        assert refused.state is EvaluationState.FAILED
        assert "prediction_horizon" in refused.reason
        assert self.evaluation(backend) == first

    def test_the_return_time_is_said_to_be_modelled(self, backend):
        assert self.evaluation(backend).details["controller.return_time_source"] == "modelled"
