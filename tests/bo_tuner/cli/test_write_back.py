"""``apply --write``: a result in a user's own parameter file."""

import os
import shlex
import subprocess
import sys

import pytest
from in_process import Uninterrupted, call, complaint
from made_runs import INITIAL, make_run, write_certificate

from bo_tuner.cli import apply as command
from bo_tuner.cli import write_back

OWN = """\
# Ours
axis:
  ros__parameters:
    gain:  0.5   # by hand
    name: 'x'
"""


@pytest.fixture
def record(tmp_path, make_study, function_backend):
    nodes = {"axis": {"node": "axis", "result": "~/r"}}
    study = make_study(nodes=nodes, constraints={}, budget=INITIAL)
    backend = function_backend(study, lambda gain, load, seed: {"error": gain + load, "peak": 0.5})
    made = make_run(tmp_path / "run", study, backend, result=1)
    write_certificate(made, made.trials[1])
    return made


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "our nodes.yaml"
    path.write_text(OWN)
    path.chmod(0o640)
    return path


@pytest.fixture
def written(record):
    """The text with the result's gain in place."""
    gain = record.trials[1].parameters["gain"]
    assert gain != 0.5
    return OWN.replace("0.5", repr(gain))


def test_the_difference_is_shown_and_the_previous_file_is_kept(record, own, written, capsys):
    code, out, err = call(command, capsys, record.path, "--write", own, "--yes")
    assert (code, err) == (0, "")
    assert own.read_text() == written
    assert own.stat().st_mode & 0o777 == 0o640
    old, new = "    gain:  0.5   # by hand", next(ln for ln in written.splitlines() if "gain" in ln)
    assert [line for line in out.splitlines() if line[:1] in "+-"] == [
        f"--- {own}", f"+++ {own} (new)", f"-{old}", f"+{new}",
    ]  # fmt: skip
    # What is printed leads back.
    back = out.splitlines()[-1].partition("restore it with: ")[2]
    subprocess.run(shlex.split(back), check=True)
    assert own.read_text() == OWN
    assert own.stat().st_mode & 0o777 == 0o640


def test_a_second_result_keeps_the_first_previous_file(record, own, written, capsys):
    call(command, capsys, record.path, "--write", own, "--yes")
    own.write_text(OWN + "# more\n")
    code, _, _ = call(command, capsys, record.path, "--write", own, "--yes")
    assert code == 0
    names = [own.with_name(f"{own.name}.previous{end}") for end in ("", ".2")]
    assert [path.read_text() for path in names] == [OWN, OWN + "# more\n"]
    code, out, _ = call(command, capsys, record.path, "--write", own, "--yes")
    assert (code, out) == (0, f"{own} has these values already; nothing to write\n")
    assert len(list(own.parent.glob("our nodes.yaml.*"))) == 2


def test_what_an_editor_has_put_in_stays(record, own, written, capsys):
    """Line breaks of another system and a byte order mark."""
    own.write_bytes(b"\xef\xbb\xbf" + OWN.replace("\n", "\r\n").encode())
    code, _, _ = call(command, capsys, record.path, "--write", own, "--yes")
    assert code == 0
    assert own.read_bytes() == b"\xef\xbb\xbf" + written.replace("\n", "\r\n").encode()


def test_a_link_stays_one(record, own, written, capsys, tmp_path):
    link = tmp_path / "link.yaml"
    link.symlink_to(own)
    code, _, _ = call(command, capsys, record.path, "--write", link, "--yes")
    assert code == 0
    assert link.is_symlink()
    assert own.read_text() == written


def test_the_values_before_a_run(record, own, written, capsys):
    own.write_text(written)
    code, _, _ = call(command, capsys, record.path, "--rollback", "--write", own, "--yes")
    assert code == 0
    assert own.read_text() == OWN


class TestNothingIsWritten:
    @pytest.fixture(autouse=True)
    def _unchanged(self, own):
        yield
        assert not list(own.parent.glob("our nodes.yaml.*"))

    def test_without_a_terminal(self, record, own, capsys, monkeypatch):
        monkeypatch.setattr(sys.stdin, "isatty", lambda: False)
        code, out, err = call(command, capsys, record.path, "--write", own)
        assert (code, err) == (2, "error: no terminal to confirm on; use --yes\n")
        assert "-    gain:  0.5   # by hand\n" in out
        assert own.read_text() == OWN

    @pytest.mark.parametrize(("answer", "code"), [(False, 3), (True, 3)])
    def test_after_no_or_another_change(self, own, monkeypatch, capsys, answer, code):
        monkeypatch.setattr(sys.stdin, "isatty", lambda: True)

        def asked(question, interruption):
            assert question == f"write {own}? [y/N] "
            if answer:
                own.write_text(OWN + "# meanwhile\n")
            return answer

        monkeypatch.setattr(write_back, "confirmed", asked)
        values = {"axis": {"gain": 0.25}}
        found = write_back.write_back(own, values, "", Uninterrupted(), yes=False)
        out, err = capsys.readouterr()
        assert found == code
        assert own.read_text() == OWN + ("# meanwhile\n" if answer else "")
        assert (f"{own} has changed meanwhile" in err) == answer
        assert ("nothing was written" in out) != answer

    def test_without_a_certificate(self, record, own, capsys):
        code, _, err = call(command, capsys, record.path, "--trial", 2, "--write", own, "--yes")
        assert code == 3
        assert "no certificate of trial 2" in err
        assert own.read_text() == OWN

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("axis:\n  ros__parameters: {a: &a 1, gain: *a}\n", "2: ROS takes no aliases"),
            ("axis:\n  gain: 1.0\n", "2: a value ahead of ros__parameters"),
            ("other:\n  ros__parameters: {gain: 1.0}\n", " says nothing of the node /axis"),
            ("/a/axis: {ros__parameters: {gain: 1.0}}\n/b/axis: {ros__parameters: {gain: 2.0}}\n",
             " has axis in several namespaces, /a/axis and /b/axis: name one"),
            ("axis: {ros__parameters: {name: \xe9}}\n".encode("latin-1"), "1: expected UTF-8 text"),
            (None, " cannot be read: No such file or directory"),
        ],
    )  # fmt: skip
    def test_into_a_file_that_cannot_be_edited(self, record, own, capsys, text, problem):
        if text is None:
            own.unlink()
        else:
            own.write_bytes(text if isinstance(text, bytes) else text.encode())
        code, out, err = call(command, capsys, record.path, "--write", own, "--yes")
        assert (code, out) == (2, "")
        assert err.startswith(f"error: {own}:{problem}")
        assert text is None or own.read_bytes() in (text, str(text).encode())

    def test_into_a_pipe(self, record, own, capsys):
        own.unlink()
        os.mkfifo(own)
        said = complaint(command, capsys, record.path, "--write", own, "--yes")
        assert said == f"error: {own}: expected a file"


def test_the_node_of_the_namespace_that_is_named(record, own, capsys):
    text = "/a/axis: {ros__parameters: {gain: 1.0}}\n/b/axis: {ros__parameters: {gain: 2.0}}\n"
    own.write_text(text)
    options = ("--yes", "--ros-args", "-r", "__ns:=/b")
    code, _, err = call(command, capsys, record.path, "--write", own, *options)
    assert (code, err) == (0, "")
    assert own.read_text() == text.replace("2.0", repr(record.trials[1].parameters["gain"]))
