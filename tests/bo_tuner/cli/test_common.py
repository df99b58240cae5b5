"""What all commands share."""

import importlib
import re
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import pytest
from commands import start

from bo_tuner.cli.common import attached, in_namespace_of, run_folder
from bo_tuner.cli.executables import module_of
from bo_tuner.errors import RunRecordError
from bo_tuner.storage.session_options import SessionOptions

COMMANDS = (
    "apply", "check", "guard", "init", "recompute", "replay", "report", "try", "tune", "validate",
)  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_version(capsys, name):
    parser = importlib.import_module(module_of(name)).make_parser()
    with pytest.raises(SystemExit) as caught:
        parser.parse_args(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith(f"{name} {version('bo_tuner')} (commit ")


@pytest.mark.parametrize("date", ["x", "1.5", "1" * 30])
def test_a_time_of_builds_that_is_none(date, tmp_path):
    """NumPy reads it in an import."""
    with start("report", "runs/a", folder=tmp_path, env={"SOURCE_DATE_EPOCH": date}) as command:
        out, err = command.communicate()
    said = f"error: SOURCE_DATE_EPOCH: expected whole seconds since 1970, found '{date}'\n"
    assert (command.returncode, out, err) == (2, "", said)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_80_columns_and_tells_the_exit_codes(name):
    text = importlib.import_module(module_of(name)).make_parser().format_help()
    assert max(map(len, text.splitlines())) <= 80
    told = set(re.findall(r"^  (\d+)\s+\w", text, re.MULTILINE))
    # These judge nothing.
    assert told >= {"0", "1", "2", "130"} | (
        set() if name in ("report", "guard", "init") else {"3"}
    )


@pytest.mark.parametrize("name", ["check", "try", "tune", "validate"])
def test_no_option_stands_outside_the_groups_of_the_help(name):
    parser = importlib.import_module(module_of(name)).make_parser()
    text = parser.format_help()
    general = text.partition("\noptions:\n")[2].partition("\n\n")[0]
    assert re.findall(r"^  .*?(--\w+)", general, re.MULTILINE) == ["--help", "--version"]
    assert len(re.findall(r"^[a-z ]+:\n  --", text, re.MULTILINE)) >= 2


class TestLatest:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)

    def test_is_the_one_in_runs(self, tmp_path):
        (tmp_path / "runs" / "latest").mkdir(parents=True)
        assert run_folder(Path("latest")) == Path("runs/latest")

    def test_a_folder_of_that_name_comes_first(self, tmp_path):
        (tmp_path / "runs" / "latest").mkdir(parents=True)
        (tmp_path / "latest").mkdir()
        assert run_folder(Path("latest")) == Path("latest")

    def test_other_paths_are_what_they_say(self):
        assert run_folder(Path("x/latest")) == Path("x/latest")

    def test_none(self):
        with pytest.raises(RunRecordError, match="runs/latest: no such run folder"):
            run_folder(Path("latest"))


def of_run(**options):
    return SimpleNamespace(options=SessionOptions(**options))


@pytest.mark.parametrize(
    ("options", "backend", "expected"),
    [
        ([], "ros", True),
        (["--no-attach"], "ros", False),
        (["--attach"], "ros", True),
        ([], "inprocess", False),
    ],
)
def test_nodes_are_attached_as_in_the_run(options, backend, expected):
    parser = importlib.import_module("bo_tuner.cli.replay").make_parser()
    arguments = parser.parse_args(["run", *options])
    assert attached(arguments, parser, backend, of_run(attached=True)) is expected
    assert attached(arguments, parser, backend, of_run(attached=False)) is ("--attach" in options)
    assert attached(arguments, parser, backend, None) is ("--attach" in options)


@pytest.mark.parametrize("name", sorted({*COMMANDS} - {"tune", "init", "check", "try", "guard"}))
def test_a_run_may_be_called_latest(name):
    text = importlib.import_module(module_of(name)).make_parser().format_help()
    assert "or 'latest' for runs/latest" in " ".join(text.split())


@pytest.mark.parametrize(
    ("recorded", "given", "expected"),
    [
        ("/cell", [], ["--ros-args", "-r", "__ns:=/cell"]),
        ("/cell", ["--ros-args", "-p", "a:=1"], ["--ros-args", "-p", "a:=1", "-r", "__ns:=/cell"]),
        ("/cell", ["--ros-args", "--"], ["--ros-args", "-r", "__ns:=/cell"]),
        ("/cell", ["--ros-args", "-r", "__ns:=/"], ["--ros-args", "-r", "__ns:=/"]),
        ("/", [], []),
        ("", [], []),
    ],
)
def test_a_command_on_a_run_is_for_the_nodes_in_its_namespace(recorded, given, expected):
    assert in_namespace_of(of_run(namespace=recorded), given) == expected
