"""What the page of a run in progress may ask of the run, if it is allowed to."""

import json

from commands import Fork, finish
from waiting import count_in

from bo_tuner.evidence.run_verdict import run_verdict
from bo_tuner.evidence.words.verdict import sentences
from bo_tuner.plans import Event, EventKind
from bo_tuner.storage.journal_reader import read_journal
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.summary import summary_from_record, with_summary


class TestRequests:
    def test_only_the_page_itself_may_ask(self, held):
        run = held(6, "--web-control")
        refused = [
            {"Origin": ""},
            {"Origin": "null"},
            {"Origin": "http://evil.example"},
            {"Origin": f"https://127.0.0.1:{run.port}"},
            {"Origin": f"http://127.0.0.1:{run.port + 1}"},
            # The host is right, but the page was read under another name.
            {"Origin": f"http://localhost:{run.port}"},
            {"X-Control-Token": ""},
            {"X-Control-Token": "wrong"},
            {"X-Control-Token": run.token},
        ]
        for headers in refused:
            assert run.request("abort", **headers)[0] == 403, headers
        control = run.origin | {"X-Control-Token": run.control_token()}
        # Not even with the right token in the header, without the one in the cookie.
        assert run.ask("/requests/abort", method="POST", token=False, **control)[0] == 403
        assert run.ask("/requests/abort", **control)[0] == 405
        assert run.request("start")[0] == 405
        # Nothing of it has reached the run.
        run.go_on()
        assert run.finished() == 0

    def test_pause_and_continue(self, held):
        run = held(6, "--web-control")
        assert run.request("pause")[0] == 202
        asked = "the run pauses after the present test run"
        run.state_when(lambda state, _: state["now"]["texts"].get("asked") == asked)
        run.go_on()
        run.state_when(lambda state, _: state["now"]["paused"] and state["now"]["pausing"])
        done = count_in(run.counter)
        assert done == 6
        assert run.process.poll() is None
        assert run.request("continue")[0] == 202
        run.state_when(lambda state, _: state["complete"])
        assert run.finished() == 0

    def test_the_end_during_a_pause(self, held):
        run = held(6, "--web-control")
        run.request("pause")
        run.go_on()
        run.state_when(lambda state, _: state["now"]["paused"])
        assert run.request("abort")[0] == 202
        assert run.finished() == 143
        assert "interrupted by the live page; " in run.said.read_text().splitlines()[-1]
        assert run.page_processes() == []

    def test_a_run_that_finishes_with_the_best_so_far(self, held, tmp_path):
        """The present trial is run to its end; a resumed run repeats it, unless it is to go on."""
        run = held(6, "--web-control")
        assert run.request("finish")[0] == 202
        asked = "the run begins no further trial; the best so far is then settled and validated"
        run.state_when(lambda state, _: state["now"]["texts"].get("asked") == asked)
        run.go_on()
        assert run.finished() == 0
        assert "asked to finish after 2 trials; the best so far is" in run.said.read_text()
        journal = run.folder / "journal.sqlite"
        whole = read_journal(journal)
        assert len(whole.trials) == 2
        assert whole.events == (Event("tuning", 2, EventKind.FINISH),)
        summary = json.loads((run.folder / "summary.json").read_text())
        assert summary["trial"] in (0, 1)
        assert (summary["ended_on_request"], summary["ended_by_time"]) == (True, False)
        # Verdict, and with it terminal and report, say so, too.
        remark = "The trials were ended on request: 2 trials of 5."
        assert remark in sentences(run_verdict(with_summary(read_run(run.folder), str)))

        def resume(*options):
            code, _, err = finish(
                Fork("tune", "--resume", str(run.folder), *options, folder=tmp_path)
            )
            assert code == 0, err
            return json.loads((run.folder / "summary.json").read_text())

        (run.folder / "summary.json").unlink()
        assert read_run(run.folder).finished == 2
        assert summary_from_record(read_run(run.folder)).items() <= summary.items()
        assert resume() == summary
        assert len(read_journal(journal).trials) == 2
        # To fewer trials than the budget was, and then to no more than these.
        resume("--trials", "4")
        assert len(read_journal(journal).trials) == 4
        assert resume()["ended_on_request"] is False
        content = read_journal(journal)
        assert len(content.trials) == 4
        assert content.events == (*whole.events, Event("tuning", 2, EventKind.EXTEND))
        code, _, err = finish(
            Fork("tune", "--resume", str(run.folder), "--trials", "4", folder=tmp_path)
        )
        assert code == 2
        assert "--trials: expected more than the 4 of the run, found 4" in err

    def test_they_need_a_page(self, tmp_path):
        code, out, err = finish(Fork("tune", "--web-control", folder=tmp_path))
        assert (code, out) == (2, "")
        assert "--web-control needs --web" in err
