"""Metrics by a function of the user."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from plans import PATH, plan
from signal_runs import outcome_of, signal_study
from waiting import wait_until

from bo_tuner.errors import StudyError
from bo_tuner.interruption import Interrupted
from bo_tuner.metrics.collect import Collector
from bo_tuner.metrics.recording import RecordedMessages, RecordedSignal, Recording
from bo_tuner.metrics.signal_sources import signal_sources
from bo_tuner.study.study_file import load_study, parse_study, study_from_mapping, study_to_yaml
from bo_tuner.trials import EvaluationState

FUNCTIONS = """
import collections, itertools, os, signal, sys
import numpy as np

def energy(signals):
    time, value = signals["x"]
    return np.sum(value[:-1] ** 2 * np.diff(time))

def seen(signals):
    raise ValueError({name: np.asarray(seen).tolist() for name, seen in signals.items()})

def absent(signals):
    return signals["z"][1].max()

def nothing(signals): pass
def text(signals): return "3.0"
def array(signals): return np.ones(1)
def truth(signals): return True
def nan(signals): return float("nan")
def huge(signals): return 10**400
def late(signals):
    time, value = signals["x"]
    time += 5.0
    value *= 0.0
    return 0.0

number = 3.0

class Wild(float):
    def __float__(self): raise ZeroDivisionError("of its own")

def leaves(signals): sys.exit(0)
def stops(signals): raise KeyboardInterrupt
def exits(signals): os._exit(3)
def crashes(signals): os.kill(os.getpid(), signal.SIGSEGV)
def moves(signals):
    os.chdir("/")
    return 1.0
def wild(signals): return Wild(1.0)
def where(signals):
    print("to be read by nobody")
    return float(os.path.exists("limits.csv"))
def mark(text):
    with open("mark", "w") as file:
        file.write(text)
def loops(signals):
    mark(str(os.getpid()))
    while True:
        try:
            pass
        except BaseException:
            pass
def length_of_plans(signals):
    times, plans = signals["plan"]
    assert list(times) == [0.0, 2.0]
    lengths = []
    for plan in plans:
        places = np.array([(p.pose.position.x, p.pose.position.y) for p in plan.poses])
        lengths.append(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    return sum(lengths)
def loops_in_c(signals):
    mark(str(os.getpid()))
    collections.deque(itertools.repeat(1), maxlen=0)
"""
# x is 0 before the start, 2 from 1 s and 4 from 3 s on.
X = RecordedSignal(np.array([-0.7, 1.0, 3.0]), np.array([0.0, 2.0, 4.0]))
EMPTY = RecordedSignal(np.array([]), np.array([]))
RECORDING = Recording({"x": X, "y": EMPTY}, end=5.0)


@pytest.fixture(autouse=True)
def functions(tmp_path, monkeypatch):
    (tmp_path / "users_metrics.py").write_text(FUNCTIONS)
    (tmp_path / "users_broken.py").write_text("import no_such_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("users_metrics", "users_broken"):
        monkeypatch.delitem(__import__("sys").modules, name, raising=False)


def study(path, folder="", **keys):
    signals = {name: {"topic": name, "field": "data", "minimum_messages": 0} for name in "xy"}
    metrics, objective = {"own": {"python": path, "unit": "J"} | keys}, {"metric": "own"}
    sections = {"signals": signals, "metrics": metrics, "objective": objective}
    return study_from_mapping(signal_study(folder=str(folder), **sections))


def outcome(function):
    return outcome_of(study(f"users_metrics:{function}"), RECORDING)


def test_a_function_of_the_signals():
    found = outcome("energy")
    # 2² for 2 s and 4² for 2 s.
    assert (found.state, found.metrics) == (EvaluationState.COMPLETE, {"own": 40.0})


def test_what_the_function_is_given():
    """The value that holds at the start stands at 0, and the last one at the end."""
    assert "{'x': [[0.0, 1.0, 3.0, 5.0], [0.0, 2.0, 4.0, 4.0]]}" in outcome("seen").reason


def test_a_function_cannot_change_the_recording():
    assert outcome("late").metrics == {"own": 0.0}
    np.testing.assert_array_equal([X.time, X.value], [[-0.7, 1, 3], [0, 2, 4]])


def test_a_function_of_whole_messages():
    """As objects with their fields; the one that holds at the start has the time 0."""
    data = (plan((0, 0), (3, 4)), plan((0, 0), (1, 0), (1, 1)))
    heard = RecordedMessages(np.array([-0.3, 2.0]), PATH, data)
    with_plans = Recording(RECORDING.signals, RECORDING.end, {"plan": heard})
    found = outcome_of(study("users_metrics:length_of_plans"), with_plans)
    assert found.metrics == {"own": 7.0}, found.reason


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("absent", "metric own: users_metrics:absent raised KeyError: 'z'"),
        ("nothing", "metric own: users_metrics:nothing returned nothing, expected a number"),
        ("text", "metric own: users_metrics:text returned text '3.0', expected a number"),
        ("array", "metric own: users_metrics:array returned a ndarray, expected a number"),
        ("truth", "metric own: users_metrics:truth returned true, expected a number"),
        ("nan", "metric own is nan"),
        ("huge", "metric own: users_metrics:huge returned a int that is no number: OverflowError"),
        ("wild", "metric own: users_metrics:wild returned a Wild that is no number: ZeroDivisionE"),
        ("leaves", "metric own: users_metrics:leaves raised SystemExit: 0"),
        ("stops", "metric own: users_metrics:stops raised KeyboardInterrupt"),
        ("exits", "metric own: users_metrics:exits ended its process: exit code 3"),
        ("crashes", "metric own: users_metrics:crashes ended its process: killed by SIGSEGV"),
        ("moves", "metric own: users_metrics:moves changed the working directory to /"),
    ],
)
def test_no_number(function, reason):
    found = outcome(function)
    assert found.state is EvaluationState.FAILED
    assert found.reason.startswith(reason)


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        ("users_metrics:energie", "cannot import users_metrics:energie: AttributeError: module"),
        ("users_broken:f", "cannot import users_broken:f: ModuleNotFoundError: No module named"),
        ("users_metrics:number", "expected a function, found 3.0"),
    ],
)
def test_no_function(path, problem):
    with pytest.raises(StudyError) as caught:
        outcome_of(study(path), RECORDING)
    assert str(caught.value).startswith(f"metrics.own.python: {problem}")


def test_what_is_written_reads_back_equal():
    made = study("users_metrics:energy")
    assert parse_study(study_to_yaml(made)) == made


def is_there(pid):
    """Whether a process runs: what it was may not have been collected yet."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except FileNotFoundError:
        return False
    return status.rpartition(")")[2].split()[0] not in "ZX"


LOOPS = pytest.mark.parametrize("function", ["loops", "loops_in_c"])


@LOOPS
def test_an_interruption_ends_a_function(tmp_path, function):
    """Also one that catches everything, or that never comes back to Python."""

    def interrupted():
        # Once the function is at work.
        if (tmp_path / "mark").exists() and (tmp_path / "mark").read_text():
            raise Interrupted(signal.SIGINT)

    made = study(f"users_metrics:{function}", tmp_path)
    with (
        pytest.raises(Interrupted),
        signal_sources(made, lambda: RECORDING, interrupted) as sources,
    ):
        Collector(made, sources).outcome({})
    assert not is_there(int((tmp_path / "mark").read_text()))


@LOOPS
def test_a_function_that_takes_too_long(tmp_path, function):
    """The run fails by name, and the next one is computed."""
    made = study(f"users_metrics:{function}", tmp_path, timeout=0.5)
    with signal_sources(made, lambda: RECORDING) as sources:
        found = Collector(made, sources).outcome({})
    assert found.state is EvaluationState.FAILED
    reason = f"metric own: users_metrics:{function} took longer than its timeout of 0.5 s"
    assert found.reason == reason
    assert not is_there(int((tmp_path / "mark").read_text()))


def test_after_a_crash_the_next_run_is_computed():
    made = study("users_metrics:crashes")
    own = study("users_metrics:energy").metrics["own"]
    with signal_sources(made, lambda: RECORDING) as sources:
        assert not Collector(made, sources).outcome({}).complete
        process = sources["own"]._process
        assert process.compute(own.python, {"x": (X.time, X.value)}, None) >= 0.0


def test_the_process_ends_with_a_tuner_that_is_killed(tmp_path):
    program = (
        "import sys\n"
        "from bo_tuner.metrics.python_process import PythonProcess\n"
        "process = PythonProcess(sys.argv[1], lambda: None)\n"
        "process.compute('users_metrics:loops', {}, None)\n"
    )
    mark = tmp_path / "mark"
    with subprocess.Popen([sys.executable, "-c", program, tmp_path]) as tuner:
        wait_until(lambda: mark.exists() and mark.read_text(), "the function", tuner)
        tuner.kill()
    wait_until(lambda: not is_there(int(mark.read_text())), "its end")


def test_what_a_function_prints_is_no_output_of_the_command(capfd):
    assert outcome("where").complete
    assert capfd.readouterr().out == ""


class TestFolder:
    @pytest.fixture
    def beside(self, tmp_path):
        """Path of a study with a module and a file beside it, which nothing else leads to."""
        folder = tmp_path / "machine"
        folder.mkdir()
        (folder / "metrics_beside.py").write_text(FUNCTIONS)
        (folder / "limits.csv").touch()
        (folder / "study.yaml").write_text(study_to_yaml(study("metrics_beside:where")))
        return folder / "study.yaml"

    def test_a_module_beside_the_study_file(self, beside):
        assert outcome_of(load_study(beside), RECORDING).metrics == {"own": 1.0}

    def test_the_record_says_where_that_was(self, beside, tmp_path, monkeypatch):
        """A run is continued from another folder, and its own folder is no folder of code."""
        written = study_to_yaml(load_study(beside))
        monkeypatch.chdir(tmp_path)
        assert outcome_of(parse_study(written), RECORDING).metrics == {"own": 1.0}

    def test_a_folder_of_code_elsewhere(self, beside, tmp_path):
        other = tmp_path / "other" / "study.yaml"
        other.parent.mkdir()
        other.write_text(beside.read_text() + "folder: ../machine\n")
        assert outcome_of(load_study(other), RECORDING).metrics == {"own": 1.0}

    def test_an_installed_module_comes_first(self, beside):
        """A file of that name must not take its place in the process of the tuner's own code."""
        (beside.parent / "numpy.py").write_text("raise RuntimeError('taken for numpy')")
        assert outcome_of(load_study(beside), RECORDING).complete

    def test_a_folder_that_is_gone(self, beside):
        made = load_study(beside)
        beside.parent.rename(beside.parent.with_name("moved"))
        with pytest.raises(StudyError, match=f"^folder: there is no folder {beside.parent}$"):
            outcome_of(made, RECORDING)
