"""Setting a result on nodes: certified, all or nothing; tests/ros has it on real ones."""

import json
import os
import signal
from dataclasses import replace

import pytest
from made_runs import INITIAL, Uninterrupted, make_run, write_certificate

from bo_tuner.cli import apply as command
from bo_tuner.deploy.apply import (
    ApplyError,
    NodeError,
    RefusedError,
    certificate_problem,
    read_values,
    set_values,
)
from bo_tuner.deploy.bundle import differences
from bo_tuner.interruption import Interrupted

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


class TestSetValues:
    def test_all_nodes_run_the_new_values(self):
        nodes = FakeNodes()
        set_values(nodes, read_values(nodes, NEW), NEW)
        assert nodes.values == NEW

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


def apply(capsys, *arguments):
    """Run the command; returns its exit code and its one line of complaint."""
    code = command.run([str(argument) for argument in arguments], Uninterrupted())
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    return code, line


class TestCertificate:
    def test_passed(self, record):
        write_certificate(record, record.trials[1])
        assert certificate_problem(record, record.trials[1]) == ""

    @pytest.mark.parametrize(
        ("write", "complaint"),
        [
            (lambda record, trial: None, "no such certificate; run validate"),
            (
                lambda record, trial: write_certificate(record, trial, "FAIL"),
                "expected PASS, found FAIL",
            ),
            (
                lambda record, trial: write_certificate(record, trial, None),
                "expected PASS, found nothing",
            ),
            (
                lambda record, trial: write_certificate(record, trial, gain=0.123),
                "certifies another parameter set; run validate",
            ),
            (
                lambda record, trial: write_certificate(record, record.trials[2]),
                "certifies another parameter set; run validate",
            ),
            (
                lambda record, trial: write_certificate(
                    record, trial, study=record.study.replace(trials=4)
                ),
                "belongs to another version of the study; run validate",
            ),
            (
                lambda record, trial: write_certificate(record, trial, more=1.0),
                "certifies another parameter set; run validate",
            ),
        ],
    )
    def test_not_passed(self, record, capsys, write, complaint):
        write(record, record.trials[1])
        assert complaint in certificate_problem(record, record.trials[1])
        code, line = apply(capsys, record.path, "--yes")
        assert code == 3
        assert line.startswith("error: ")
        assert complaint in line

    @pytest.mark.parametrize(
        "content", ["", "{", "[]", "7", '{"verdict": "PASS"}', '{"parameters": 7}', "\x00"]
    )
    def test_garbage(self, record, capsys, content):
        write_certificate(record, record.trials[1])
        (record.path / "certificate.json").write_text(content)
        code, line = apply(capsys, record.path, "--yes")
        assert code == 3
        assert "certificate.json: " in line


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
        assert command._confirmed("set these? [y/N] ", Uninterrupted()) is yes
        assert capsys.readouterr().out == "set these? [y/N] "

    def test_the_end_of_the_input_is_a_no(self, terminal):
        terminal.close()
        assert command._confirmed("set these? ", Uninterrupted()) is False

    def test_a_signal_ends_the_wait(self, terminal):
        class Signalled(Uninterrupted):
            def check(self):
                raise Interrupted(signal.SIGINT)

        with pytest.raises(Interrupted):
            command._confirmed("set these? ", Signalled())


class TestMistakes:
    def test_no_run(self, tmp_path, capsys):
        code, line = apply(capsys, tmp_path / "nothing")
        assert (code, line) == (2, f"error: {tmp_path / 'nothing'}: no such run folder")

    @pytest.mark.parametrize("option", [(), ("--rollback",), ("--without-certificate", "--yes")])
    def test_a_run_that_has_not_ended(self, record, capsys, option):
        (record.path / "summary.json").unlink()
        code, line = apply(capsys, record.path, *option)
        assert code == 2
        assert "has no result" in line

    def test_a_result_that_is_not_on_record(self, record, capsys):
        (record.path / "summary.json").write_text(json.dumps({"trial": 77}))
        code, line = apply(capsys, record.path, "--yes")
        assert code == 2
        assert "its summary names trial 77, not on record" in line

    def test_unknown_option(self, record, capsys):
        with pytest.raises(SystemExit) as caught:
            apply(capsys, record.path, "--force")
        assert caught.value.code == 2
        assert "--force" in capsys.readouterr().err

    def test_help_tells_exit_codes_and_examples(self, capsys):
        with pytest.raises(SystemExit) as caught:
            command.run(["--help"], Uninterrupted())
        assert caught.value.code == 0
        text = capsys.readouterr().out
        assert "exit codes:" in text
        assert "examples:" in text


def test_a_certificate_of_other_types_of_numbers_is_of_the_same_parametrization(record):
    trial = replace(record.trials[1], parameters={"gain": 1.0})
    write_certificate(record, trial, gain=1)
    assert certificate_problem(record, trial) == ""
