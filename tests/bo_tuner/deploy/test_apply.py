"""Setting a result on nodes: certified, all or nothing; tests/ros has it on real ones."""

import contextlib
import json
import os
import signal
import sys
from dataclasses import replace

import pytest
from draws_needed import draws_needed_without_event
from in_process import Uninterrupted, call
from made_runs import INITIAL, make_run, write_certificate
from signal_runs import signal_study

from bo_tuner.cli import apply as command
from bo_tuner.cli.streams import confirmed
from bo_tuner.deploy.apply import (
    ApplyError,
    NodeError,
    RefusedError,
    Way,
    read_values,
    set_values,
)
from bo_tuner.deploy.bundle import differences
from bo_tuner.evidence.certificate.store import certificate_problem, evaluations_path, next_path
from bo_tuner.interruption import Interrupted
from bo_tuner.report.deliverables import withdraw_result
from bo_tuner.storage.parameter_file import node_values, to_yaml
from bo_tuner.study.study_file import study_from_mapping

OLD = {"drive": {"gain": 1.0, "taps": 3}, "axis": {"load": [0.5, 1.0]}}
NEW = {"drive": {"gain": 2.5, "taps": 4}, "axis": {"load": [0.25, 2.0]}}


class FakeNodes:
    """Nodes that take everything, or misbehave to order."""

    def __init__(self, refusing=(), silent=(), rounding=()):
        self.values = {node: dict(values) for node, values in OLD.items()}
        self.refusing = refusing
        self.silent = silent
        self.rounding = rounding

    def get(self, node, names):
        return {name: self.values[node][name] for name in names}

    def set(self, node, values):
        if node in self.refusing:
            raise RefusedError(f"{node} refuses: load: too much")
        self.values[node] |= values
        if node in self.rounding and values == NEW[node]:
            self.values[node]["load"] = [0.25, 2.0000001]
        if node in self.silent and values == NEW[node]:
            raise NodeError(f"{node}: does not answer within 5 s")

    def is_configured(self, node):
        return False

    def wait(self, period):
        """Time is nothing to these."""

    def undisturbed(self):
        return contextlib.nullcontext()

    def watch(self, values):
        """Nothing changes by itself."""

    def guarded(self, study, before, folder):
        return contextlib.nullcontext()

    def take_remarks(self):
        return []

    def before_killed(self, node, values):
        return {}

    def forget_killed(self, node, names):
        """Nothing is noted."""


class TestSetValues:
    def test_all_nodes_run_the_new_values(self):
        nodes = FakeNodes()
        set_values(nodes, read_values(nodes, NEW), NEW)
        assert nodes.values == NEW

    def test_a_node_is_told_what_changes(self):
        """One may refuse to be told a read-only value that it has."""
        told = []

        class Watched(FakeNodes):
            def set(self, node, values):
                told.append((node, values))
                super().set(node, values)

        new = {"drive": {"gain": 2.5, "taps": 3}, "axis": {"load": [0.5, 1]}}
        set_values(Watched(), OLD, new)
        assert told == [("drive", {"gain": 2.5})]

    def test_only_what_is_to_be_set_is_read(self):
        assert read_values(FakeNodes(), {"drive": {"taps": 4}}) == {"drive": {"taps": 3}}

    @pytest.mark.parametrize(
        ("trouble", "complaint"),
        [
            ("refusing", "axis refuses: load: too much; previous values of drive restored"),
            ("silent", "axis: does not answer within 5 s; previous values of drive, axis restored"),
            ("rounding", "axis: load is [0.25, 2.0000001] after it was set to [0.25, 2.0]"),
        ],
    )
    def test_one_node_that_fails_leaves_all_as_they_were(self, trouble, complaint):
        nodes = FakeNodes(**{trouble: ("axis",)})
        with pytest.raises(ApplyError) as caught:
            set_values(nodes, OLD, NEW)
        assert complaint in str(caught.value)
        assert nodes.values == OLD

    def test_a_node_that_is_configured_has_them_in_force_at_the_end_and_after_a_failure(self):
        class Configured(FakeNodes):
            def __init__(self, **trouble):
                super().__init__(**trouble)
                self.in_force = dict(OLD)

            def is_configured(self, node):
                return node == "drive"

            def configure(self, node):
                if self.values[node] == NEW[node] and self.refusing:
                    raise NodeError("drive cannot be configured")
                self.in_force = {**self.in_force, node: dict(self.values[node])}

        nodes = Configured()
        set_values(nodes, OLD, NEW)
        assert nodes.in_force["drive"] == NEW["drive"]
        nodes.in_force = {}
        set_values(nodes, NEW, NEW)
        assert nodes.in_force["drive"] == NEW["drive"]
        nodes = Configured(refusing=("nobody",))
        with pytest.raises(ApplyError, match="cannot be configured; previous values of drive, "):
            set_values(nodes, OLD, NEW)
        assert nodes.values == OLD
        assert nodes.in_force["drive"] == OLD["drive"]

    def test_a_refusal_of_the_first_node_changes_nothing(self):
        nodes = FakeNodes(refusing=("drive",))
        with pytest.raises(ApplyError, match="drive refuses: load: too much; nothing was changed"):
            set_values(nodes, OLD, NEW)
        assert nodes.values == OLD

    def test_a_node_that_cannot_be_set_back_is_named(self):
        class Dying(FakeNodes):
            def set(self, node, values):
                if node == "drive" and values == OLD["drive"]:
                    raise NodeError("drive: does not answer within 5 s")
                super().set(node, values)

        with pytest.raises(ApplyError, match="drive could not be restored: drive: does not answer"):
            set_values(Dying(refusing=("axis",)), OLD, NEW)

    def test_values_are_restored_in_reverse_order_and_read_back(self):
        """A node may take the way up and not the way down."""
        told = []

        class Limited(FakeNodes):
            def set(self, node, values):
                told.append(node)
                super().set(node, values)
                if node == "drive" and values.get("gain") == OLD["drive"]["gain"]:
                    self.values[node]["gain"] = 2.25

        with pytest.raises(ApplyError) as caught:
            set_values(Limited(silent=("axis",)), OLD, NEW)
        # It is told once more what it has otherwise.
        assert told == ["drive", "axis", "axis", "drive", "drive"]
        assert str(caught.value) == (
            "axis: does not answer within 5 s; "
            "drive could not be restored: drive: gain is 2.25 after it was set to 1.0"
        )
        assert not caught.value.restored

    def test_what_a_node_changes_along_with_others_is_restored_too(self):
        class Coupled(FakeNodes):
            def set(self, node, values):
                super().set(node, values)
                if values.get("gain") == NEW["drive"]["gain"]:
                    self.values[node]["taps"] = 9

        new = {"drive": {"gain": 2.5, "taps": 3}, "axis": OLD["axis"]}
        nodes = Coupled()
        with pytest.raises(ApplyError, match="taps is 9 after it was set to 3; previous values of"):
            set_values(nodes, read_values(nodes, new), new)
        assert nodes.values == OLD


class TestRamp:
    """A step of 0.1 s at a time, at which the nodes are told what changes in it."""

    BEFORE, AFTER = {"servo": {"gain": 1.0}}, {"servo": {"gain": 2.0}}
    STEPS = (1.25, 1.5, 1.75, 2.0)

    class Servo(FakeNodes):
        def __init__(self, refuses=()):
            super().__init__()
            self.values = {"servo": {"gain": 1.0}}
            self.refuses = refuses
            self.told = []

        def wait(self, period):
            self.told.append(pytest.approx(period))

        def set(self, node, values):
            self.told.append(values["gain"])
            if values["gain"] in self.refuses:
                raise RefusedError(f"{node} refuses: gain: no")
            super().set(node, values)

    @pytest.fixture
    def way(self):
        study = signal_study(run={"end": {"after": 2.0}, "ramp": 0.4})
        return Way.of(study_from_mapping(study), self.BEFORE, self.AFTER)

    def test_the_nodes_go_there_in_steps(self, way):
        nodes = self.Servo()
        set_values(nodes, self.BEFORE, self.AFTER, way)
        assert nodes.told == [item for gain in self.STEPS for item in (0.1, gain)]

    @pytest.mark.parametrize(
        ("refused", "outcome", "last"),
        [
            (1.25, "nothing was changed", 1.25),
            (1.75, "previous values of servo restored", 1.0),
            (2.0, "previous values of servo restored", 1.0),
        ],
    )
    def test_what_refuses_a_step_gets_back_what_it_had_at_once(self, way, refused, outcome, last):
        nodes = self.Servo(refuses=(refused,))
        with pytest.raises(ApplyError, match=f"servo refuses: gain: no; {outcome}"):
            set_values(nodes, self.BEFORE, self.AFTER, way)
        assert nodes.told[-1] == last
        assert nodes.values == self.BEFORE

    @pytest.mark.parametrize("stays", [False, True])
    def test_a_request_to_end_on_the_way_gives_back_what_was_there(self, way, stays):
        class Interrupting(self.Servo):
            is_disturbed = True

            @contextlib.contextmanager
            def undisturbed(self):
                self.is_disturbed = False
                yield
                self.is_disturbed = True

            def wait(self, period):
                super().wait(period)
                if self.is_disturbed and self.values["servo"]["gain"] == 1.5:
                    raise Interrupted(signal.SIGINT)

            def set(self, node, values):
                assert self.is_disturbed or values == {"gain": 1.0}
                super().set(node, values)

        nodes = Interrupting(refuses=(1.0,) if stays else ())
        expected = (
            pytest.raises(ApplyError, match="interrupted by SIGINT; servo could not be restored: ")
            if stays
            else pytest.raises(Interrupted)
        )
        with expected:
            set_values(nodes, self.BEFORE, self.AFTER, way, lambda: pytest.fail("it goes on"))
        assert nodes.told == [0.1, 1.25, 0.1, 1.5, 0.1, 1.0]

    def test_a_request_to_end_at_the_last_moment(self, way):
        def commit():
            raise Interrupted(signal.SIGTERM)

        nodes = self.Servo()
        with pytest.raises(Interrupted):
            set_values(nodes, self.BEFORE, self.AFTER, way, commit)
        assert nodes.told[-2:] == [0.1, 1.0]

    def test_a_study_without_one_sets_all_at_once(self):
        way = Way.of(study_from_mapping(signal_study()), self.BEFORE, self.AFTER)
        nodes = self.Servo()
        set_values(nodes, self.BEFORE, self.AFTER, way)
        assert nodes.told == [2.0]


def test_differences_are_of_values_not_of_types(make_study):
    study = make_study(
        parameters={"gain": {"node": "axis", "type": "double", "bounds": [0.0, 1.0],
                             "default": 0.5, "unit": "1/s"}}
    )  # fmt: skip
    now = {"axis": {"gain": 1, "mode": "a", "list": [1.0, 2.0]}}
    new = {"axis": {"gain": 1.0, "mode": "b", "list": [1.0, 2.0], "more": True}}
    rows = differences(study, now, new)
    assert [(row.parameter, row.unit, row.equal) for row in rows] == [
        ("gain", "1/s", True), ("mode", "", False), ("list", "", True), ("more", "", False),
    ]  # fmt: skip


@pytest.fixture
def record(tmp_path, make_study, function_backend):
    study = make_study(constraints={}, budget=INITIAL)
    backend = function_backend(study, lambda gain, load, seed: {"error": gain + load, "peak": 0.5})
    return make_run(tmp_path / "run", study, backend, result=1)


@pytest.fixture
def objects(tmp_path, monkeypatch):
    """Function that writes the code of the study's object, which is there."""
    monkeypatch.syspath_prepend(tmp_path)
    # Another test's module of this name would be found first.
    monkeypatch.delitem(sys.modules, "axis_objects", raising=False)

    def write(text):
        (tmp_path / "axis_objects.py").write_text(text)

    write("VALUE = 1")
    return write


def apply(capsys, *arguments):
    """Run the command; returns its exit code and its one line of complaint."""
    code, out, err = call(command, capsys, *arguments)
    assert out == ""
    (line,) = err.splitlines()
    return code, line


class TestCertificate:
    def test_passed(self, record):
        write_certificate(record, record.trials[1])
        assert certificate_problem(record, record.trials[1]) == ""

    @pytest.mark.parametrize(
        ("changes", "complaint"),
        [
            ({"verdict": "FAIL"}, "expected PASS, found FAIL"),
            ({"verdict": None}, "verdict: expected PASS by its findings, found nothing"),
            ({"verdict": ["PASS"]}, "expected PASS by its findings, found a list of 1"),
            ({"parameters": {"gain": 0.123}}, "no certificate of trial 1; run validate"),
            (
                {"parameters": {"more": 1.0}},
                "parameters: expected gain, found gain, more; run validate",
            ),
            ({"parameters_sha256": "0" * 64}, "parameters do not match its digest"),
            ({"study_sha256": "0" * 64}, "belongs to another version of the study; run validate"),
            ({"evaluations_sha256": "0" * 64}, "0001_evaluations.csv does not match its digest"),
            ({"draws": 999}, "made with 999 test runs, the study requires 1000; run validate"),
            ({"draws": "1000"}, "draws: expected an integer, found text '1000'"),
            ({"draws": 1e9}, "draws: expected an integer, found 1000000000.0"),
            ({"confidence": 0.94}, "has a confidence of 0.94, the study requires 0.95"),
            ({"confidence": None}, "has a confidence of nan, the study requires 0.95"),
            ({"confidence": float("nan")}, "confidence: expected a finite number, found nan"),
            ({"provenance": {}}, "the code of bo_tuner has changed since"),
            ({"provenance": 7}, "provenance: expected a mapping, found 7"),
            ({"format": 1}, "not a certificate of this version"),
        ],
    )
    def test_not_passed(self, record, capsys, objects, changes, complaint):
        write_certificate(record, record.trials[1], **changes)
        assert complaint in certificate_problem(record, record.trials[1])
        code, line = apply(capsys, record.path, "--yes")
        assert code == 3
        assert line.startswith("error: ")
        assert complaint in line

    def test_none(self, record, capsys):
        code, line = apply(capsys, record.path, "--yes")
        assert code == 3
        assert "certificates: no certificate of trial 1; run validate" in line

    def test_of_another_study(self, record):
        write_certificate(record, record.trials[1], study=record.study.replace(trials=4))
        assert "another version of the study" in certificate_problem(record, record.trials[1])

    def test_other_code(self, record, objects):
        write_certificate(record, record.trials[1])
        assert certificate_problem(record, record.trials[1]) == ""
        objects("VALUE = 2")
        assert "the code of axis_objects has changed since; run validate" in certificate_problem(
            record, record.trials[1]
        )

    def test_evaluations_that_were_changed_or_are_gone(self, record):
        path = evaluations_path(write_certificate(record, record.trials[1]))
        path.write_text("other")
        assert "does not match its digest" in certificate_problem(record, record.trials[1])
        path.unlink()
        assert "cannot be read" in certificate_problem(record, record.trials[1])

    def test_evaluations_alone_are_no_certificate(self, record):
        """As a crash between the two files leaves them: the certificate before counts."""
        old = write_certificate(record, record.trials[1])
        evaluations_path(old.with_name("0002.json")).write_text("newer")
        assert certificate_problem(record, record.trials[1]) == ""
        assert next_path(record.path).name == "0002.json"

    @pytest.mark.parametrize(
        ("in_order", "opens"),
        [
            (["FAIL", "PASS"], True),
            (["PASS", "FAIL"], False),
            (["FAIL", "quick PASS"], False),
            (["PASS", "quick PASS"], True),
            (["PASS", "FAIL", "quick PASS"], False),
            (["PASS", "damaged"], False),
            (["PASS", "FAIL of another"], True),
            (["FAIL", "PASS of another"], False),
        ],
    )
    def test_a_fail_stands_until_a_sufficient_pass(self, record, in_order, opens):
        for what in in_order:
            verdict, _, of_another = what.partition(" of ")
            trial = record.trials[2 if of_another else 1]
            draws = {"draws": 2, "confidence": 0.001} if verdict.startswith("quick") else {}
            path = write_certificate(record, trial, verdict.split()[-1], **draws)
            if what == "damaged":
                path.write_text(path.read_text()[:-5])
        assert (certificate_problem(record, record.trials[1]) == "") is opens

    def test_a_study_may_require_more(self, tmp_path, make_study, function_backend):
        chance = {"kind": "chance", "metric": "peak", "upper": 1.0, "probability": 0.999}
        study = make_study(constraints={"peak": chance}, budget=INITIAL)
        backend = function_backend(study, lambda gain, load, seed: {"error": 1.0, "peak": 0.5})
        record = make_run(tmp_path / "strict", study, backend, result=1)
        write_certificate(record, record.trials[1])
        needed = draws_needed_without_event(0.001, 0.05)
        problem = certificate_problem(record, record.trials[1])
        assert f"1000 test runs, the study requires {needed}" in problem
        write_certificate(record, record.trials[1], draws=needed)
        assert certificate_problem(record, record.trials[1]) == ""

    @pytest.mark.parametrize(
        "content",
        ["", "{", "[]", "7", '{"verdict": "PASS"}', '{"parameters": 7}', "\x00", "[" * 100_000],
    )
    def test_garbage(self, record, capsys, content):
        write_certificate(record, record.trials[1]).write_text(content)
        code, line = apply(capsys, record.path, "--yes")
        assert code == 3
        assert "certificates/0001.json: " in line


class TestQuestion:
    @pytest.fixture
    def terminal(self, monkeypatch):
        """Function that types into what stands for the terminal."""
        reading, writing = os.pipe()
        with os.fdopen(reading) as stdin, os.fdopen(writing, "w") as keys:
            monkeypatch.setattr("sys.stdin", stdin)
            yield keys

    @pytest.mark.parametrize(
        ("typed", "yes"),
        [("y\n", True), ("YES \n", True), ("n\n", False), ("\n", False), ("yup\n", False)],
    )
    def test_only_yes_is_a_yes(self, terminal, capsys, typed, yes):
        terminal.write(typed)
        terminal.flush()
        assert confirmed("set these? [y/N] ", Uninterrupted()) is yes
        assert capsys.readouterr().out == "set these? [y/N] "

    def test_the_end_of_the_input_is_a_no(self, terminal):
        terminal.close()
        assert confirmed("set these? ", Uninterrupted()) is False

    def test_a_signal_ends_the_wait(self, terminal):
        class Signalled(Uninterrupted):
            def check(self):
                raise Interrupted(signal.SIGINT)

        with pytest.raises(Interrupted):
            confirmed("set these? ", Signalled())


class TestBundle:
    @pytest.fixture
    def gain(self, monkeypatch, tmp_path):
        """Function that returns what the node of the study has."""
        nodes = FakeNodes()
        nodes.values = {"axis": {"gain": 0.125}}
        nodes.close = lambda: None
        monkeypatch.setattr(command, "LiveParameters", lambda *_: nodes)
        monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
        self.nodes = nodes
        return lambda: nodes.values["axis"]["gain"]

    def test_does_not_lead_back_to_what_a_killed_run_has_left(self, record, capsys, gain):
        write_certificate(record, record.trials[1])
        self.nodes.before_killed = lambda node, values: {"gain": 0.25}
        code, _, err = call(command, capsys, record.path, "--yes")
        assert code == 0
        assert err == (
            "warning: axis: gain is 0.125, which a run that was killed has left; the previous "
            "value is 0.25\n"
        )
        assert gain() == record.trials[1].parameters["gain"]
        assert call(command, capsys, record.path, "--rollback", "--yes")[0] == 0
        assert gain() == 0.25

    def test_what_the_nodes_have_already_is_no_longer_of_a_killed_run(self, record, capsys, gain):
        """The next run that is attached would set them back."""
        write_certificate(record, record.trials[1])
        forgotten = []
        self.nodes.forget_killed = lambda node, names: forgotten.append((node, list(names)))
        for count in (1, 2):
            assert call(command, capsys, record.path, "--yes")[0] == 0
            assert forgotten == [("axis", ["gain"])] * count

    def test_leads_back_in_the_namespace_that_was_given(self, record, capsys, gain):
        write_certificate(record, record.trials[1])
        options = ("--yes", "--ros-args", "-r", "__ns:=/cell")
        code, out, _ = call(command, capsys, record.path, *options)
        assert code == 0
        assert f"apply {record.path} --rollback --ros-args -r __ns:=/cell\n" in out

    def test_is_of_the_result_also_after_another_trial_was_set(self, record, capsys, gain):
        write_certificate(record, record.trials[2])
        bundle = record.path / "deploy"
        code, out, err = call(command, capsys, record.path, "--trial", 2, "--yes")
        assert (code, err) == (0, "")
        assert gain() == record.trials[2].parameters["gain"]
        result = to_yaml(node_values(record.study, record.trials[1].parameters))
        assert (bundle / "parameters.yaml").read_text() == result
        assert f"{bundle / 'parameters.yaml'} holds trial 1, the result; " in out
        assert json.loads((bundle / "provenance.json").read_text())["trial"] == 1

    def test_leads_back_also_while_a_continued_run_has_no_result(self, record, capsys, gain):
        write_certificate(record, record.trials[1])
        code, out, _ = call(command, capsys, record.path, "--yes")
        assert (code, "holds trial" in out) == (0, False)
        assert gain() == record.trials[1].parameters["gain"]
        withdraw_result(record.path)
        assert call(command, capsys, record.path, "--rollback", "--yes")[0] == 0
        assert gain() == 0.125


class TestMistakes:
    def test_no_run(self, tmp_path, capsys):
        code, line = apply(capsys, tmp_path / "nothing")
        assert (code, line) == (2, f"error: {tmp_path / 'nothing'}: no such run folder")

    @pytest.mark.parametrize("option", [(), ("--trial", "0"), ("--without-certificate", "--yes")])
    def test_a_run_that_has_not_ended(self, record, capsys, option):
        (record.path / "summary.json").unlink()
        code, line = apply(capsys, record.path, *option)
        assert code == 2
        assert "has no result" in line

    def test_a_result_that_is_not_on_record(self, record, capsys):
        (record.path / "summary.json").write_text(json.dumps(record.summary | {"trial": 77}))
        code, _, err = call(command, capsys, record.path, "--yes")
        warning, line = err.splitlines()
        assert code == 2
        assert "summary.json: not the summary of this record; ignored, since the run has" in warning
        assert "has no result" in line

    def test_unknown_option(self, record, capsys):
        code, line = apply(capsys, record.path, "--force")
        assert code == 2
        assert "--force" in line

    def test_help_tells_exit_codes_and_examples(self, capsys):
        code, text, _ = call(command, capsys, "--help")
        assert code == 0
        assert "exit codes:" in text
        assert "examples:" in text


def test_a_certificate_of_other_types_of_numbers_is_of_the_same_parametrization(record):
    trial = replace(record.trials[1], parameters={"gain": 1.0})
    write_certificate(record, trial, parameters={"gain": 1})
    assert certificate_problem(record, trial) == ""
