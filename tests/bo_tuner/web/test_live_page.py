"""The page of a run in progress, asked by an HTTP client: what it shows, and its end.

tests/browser has the same page as a reader sees it.
"""

import http.client
import json
import os
import re
import signal
from types import SimpleNamespace

import pytest
from live_run import page_processes
from waiting import DEADLINE, wait_until

from bo_tuner.methods.registry import METHODS
from bo_tuner.monitoring.control import RunControl
from bo_tuner.monitoring.status import RunStatus
from bo_tuner.plans import Phase
from bo_tuner.study.study_file import study_to_yaml
from bo_tuner.tuning.gate import Gate
from bo_tuner.web.address import listen
from bo_tuner.web.live_page import LivePage


class TestWhatItShows:
    def test_trials_and_then_the_result(self, held):
        # Evaluations 1 to 8 are those of trials 0 and 1.
        run = held(9)
        sections = run.state_when(lambda state, made: "trials" in made)
        assert ">2 trials<" in sections["trials"]
        # No report: it is a page of its own, one click away.
        assert set(sections) == {"objective", "limits", "trials", "values"}
        status, _, report = run.ask(f"/runs/{run.name}")
        assert status == 200
        assert "No result yet: 2 of 5 trials" in report

        run.go_on()
        sections = run.state_when(lambda state, made: state["complete"])
        assert ">5 trials<" in sections["trials"]
        assert "no limit broken" in sections["answer"]
        assert run.finished() == 0
        assert run.page_processes() == []

    def test_the_present_state(self, held):
        run = held(8)
        found = []
        run.state_when(lambda state, _: state["now"].get("trials") == 2 and not found.append(state))
        now = found[-1]["now"]
        assert (now["phase"], now["done"], now["total"], now["trials"]) == ("tuning", 2, 5, 2)
        assert re.match(r"(trial \d|none yet)", now["best"])
        assert re.fullmatch(r"\d+:\d\d:\d\d", now["time_left"])
        assert re.match(r"trial 2, (no|1) test run finished", now["texts"]["running"])

    def test_a_failure_with_its_reason_and_its_page(self, held):
        run = held(3, FAILING="1000")
        sections = run.state_when(lambda state, made: "trials" in made)
        assert "axis: stalled [/x] for good" in sections["trials"]
        status, _, page = run.ask(f"/runs/{run.name}/trials/0")
        assert status == 200
        assert "Trial 0: failed" in page
        assert "axis: stalled [/x] for good" in page

    def test_json_lines_and_quiet_name_the_address_too(self, held):
        run = held(3, "--quiet")
        assert run.said.read_text().startswith("live page: http://127.0.0.1:")


class TestEnd:
    @pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
    def test_by_a_signal(self, held, signum, code):
        run = held(6)
        assert len(run.page_processes()) == 1
        run.process.send_signal(signum)
        run.go_on()
        assert run.finished() == code
        assert "interrupted by" in run.said.read_text().splitlines()[-1]
        assert run.page_processes() == []
        # The port is free again.
        with listen(run.port).socket:
            pass

    def test_of_a_run_that_is_killed(self, held):
        run = held(6)
        assert len(run.page_processes()) == 1
        run.process.kill()
        wait_until(lambda: run.page_processes() == [], "the end of the page")

    def test_a_reader_is_told_that_a_run_was_killed(self, held):
        """And the page, with its port, does not outlast it for that reader."""
        run = held(6)
        run.ask("/state?after=-1")
        run.process.kill()
        now = {}

        def over():
            try:
                now.update(json.loads(run.ask("/state?after=-1")[2])["now"])
            except (OSError, http.client.HTTPException):
                return True
            return now.get("ended")

        wait_until(over, "the end")
        wait_until(lambda: run.page_processes() == [], "the end of the page")

    def test_of_the_page_leaves_the_run_alone(self, held):
        run = held(6)
        for pid in run.page_processes():
            os.kill(pid, signal.SIGKILL)
        run.go_on()
        assert run.finished() == 0
        assert run.said.read_text().count("the live page has ended") == 1


def test_a_page_that_hangs_does_not_hold_the_run(tmp_path, make_study):
    study = make_study()
    status = RunStatus(study, METHODS["IV"])
    warnings = []
    with LivePage(study, tmp_path, status, listen(0), warnings.append) as page:
        wait_until(lambda: page_processes(tmp_path), "the process of the page")
        (pid,) = page_processes(tmp_path)
        os.kill(pid, signal.SIGSTOP)
        status.begin(Phase.TUNING, 5)
        # Far more than a pipe holds.
        for _ in range(5000):
            page.advance()
        os.kill(pid, signal.SIGCONT)
    assert warnings == []


def test_before_there_is_a_record_the_page_loads_itself_again(tmp_path, make_study):
    """The address is told before the nodes are up; a run that does not start leaves no log."""
    study = make_study()
    status = RunStatus(study, METHODS["IV"])
    address = listen(0)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "study.yaml").write_text(study_to_yaml(study))
    with LivePage(study, tmp_path / "run", status, address, pytest.fail):
        answers = {}
        for path in ("/", "/runs/run"):
            connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=DEADLINE)
            cookie = {"Cookie": f"bo_tuner_{address.port}={address.token}"}
            connection.request("GET", path, headers=cookie)
            answer = connection.getresponse()
            answers[path] = answer.status, answer.headers["Refresh"], answer.read().decode()
            connection.close()
    code, refresh, text = answers["/"]
    assert (code, refresh) == (503, "1")
    assert len(text.splitlines()) == 1
    assert "journal" in text
    code, refresh, text = answers["/runs/run"]
    assert (code, refresh) == (404, None)
    assert len(text.splitlines()) == 1
    assert (tmp_path / "run" / "log" / "web.log").read_text() == ""


class TestWhatWasAsked:
    @pytest.fixture
    def told(self, tmp_path, make_study, make_trial):
        """Function for what the page tells was asked, after some requests and an evaluation."""
        study = make_study()
        control = RunControl(Gate(), SimpleNamespace(request=lambda _: None), tmp_path)
        trial = make_trial(0, {"gain": 0.5}, [1.0])
        steps = {
            "evaluation": lambda page: page.evaluation(trial.evaluations[0]),
            "trial": lambda page: page.trial(trial, None),
        }

        def told(step, *requests):
            status = RunStatus(study, METHODS["IV"])
            address = listen(0)
            # No process serves it.
            address.socket.close()
            page = LivePage(study, tmp_path, status, address, pytest.fail, control)
            messages = []
            page._send = messages.append
            reads, writes = os.pipe()
            os.write(writes, "".join(f"{request}\n" for request in requests).encode())
            os.close(writes)
            page._take(reads, control)
            assert messages[-1]["texts"]["asked"]
            steps[step](page)
            page.advance()
            return messages[-1]["texts"].get("asked", "")

        return told

    @pytest.mark.parametrize("step", ["evaluation", "trial"])
    def test_it_is_told_until_it_has_come(self, told, step):
        assert told(step, "pause", "continue") == ""
        assert told(step, "pause") == "the run pauses after the present test run"
        assert told(step, "continue") == ""

    @pytest.mark.parametrize("step", ["evaluation", "trial"])
    def test_the_end_is_told_until_it_has_come(self, told, step):
        assert told(step, "abort").startswith("the run ends; ")
