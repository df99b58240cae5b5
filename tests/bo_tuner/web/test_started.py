"""Commands that pages of runs start, where ``report --serve`` allows it."""

import asyncio
import json
import re
import shutil
import sys

import pytest
from pages import ServedRuns
from report_runs import run_axis

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.what_if import command
from bo_tuner.report.to_start import to_start
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.summary import with_summary
from bo_tuner.web.started import RunningError, Started

# As our commands do: whoever runs the tests may have them ignore the signal.
HEARS = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
SAYS = HEARS + "import sys, time; print(*sys.argv[1:], flush=True); time.sleep({})"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of a small object; nobody changes it."""
    return run_axis(tmp_path_factory.mktemp("finished"))


@pytest.fixture(scope="module")
def served(finished, tmp_path_factory):
    """A folder with one run, whose page may start commands."""
    folder = tmp_path_factory.mktemp("served") / "runs"
    shutil.copytree(finished, folder / "first")
    path = str(finished.parent.parent)
    pages = ServedRuns(folder, "--web-control", PYTHONPATH=path)
    pages.folder = folder
    yield pages
    pages.end()


@pytest.fixture
def analysis(finished):
    return Analysis(with_summary(read_run(finished), str))


def started(code):
    """A program in place of ours, and the lines that are told of it."""
    told = []
    return Started(told.append, [sys.executable, "-c", code]), told


async def ended(commands):
    news = await commands.news(-1)
    while news["running"]:
        news = await commands.news(news["version"])
    return news


class TestStarted:
    def test_what_it_prints_and_how_it_ends(self):
        async def start():
            commands, told = started(SAYS.format(0))
            await commands.start(["validate", "my run"], "127.0.0.1")
            return await ended(commands), told

        news, told = asyncio.run(start())
        assert news["command"] == "validate 'my run'"
        assert news["lines"] == ["validate my run"]
        assert news["exit_code"] == 0
        assert told == [
            "started from the page by 127.0.0.1: validate 'my run'",
            "validate has ended with exit code 0",
        ]

    def test_one_at_a_time_until_it_is_ended(self):
        async def start():
            commands, _ = started(SAYS.format(600))
            await commands.start(["try"], "-")
            with pytest.raises(RunningError, match="try is running"):
                await commands.start(["validate"], "-")
            while not (await commands.news(-1))["lines"]:
                await asyncio.sleep(0.01)
            commands.stop()
            first = await ended(commands)
            commands, _ = started(SAYS.format(0))
            await commands.start(["validate"], "-")
            return first, await ended(commands)

        first, second = asyncio.run(start())
        assert first["exit_code"] not in (0, None)
        assert second["exit_code"] == 0

    def test_the_end_of_the_server_ends_it_and_waits(self):
        code = HEARS + (
            "import sys, time\n"
            "try:\n    print('on', flush=True); time.sleep(600)\n"
            "except KeyboardInterrupt:\n    print('safe')\n"
        )

        async def start():
            commands, told = started(code)
            await commands.start(["validate"], "-")
            while not (await commands.news(-1))["lines"]:
                await asyncio.sleep(0.01)
            await commands.close()
            return (await commands.news(-1))["lines"], told

        lines, told = asyncio.run(start())
        assert lines == ["on", "safe"]
        assert told[-1] == "validate has ended with exit code 0"

    def test_a_line_that_has_no_end_is_not_kept(self):
        async def start():
            commands, _ = started("print('x' * 300_000); print('next')")
            await commands.start(["try"], "-")
            return (await ended(commands))["lines"]

        assert "next" in asyncio.run(start())[-1]

    def test_escape_sequences_do_not_reach_the_page(self):
        async def start():
            commands, _ = started(r"print('\x1b[31mred')")
            await commands.start(["try"], "-")
            return (await ended(commands))["lines"]

        (line,) = asyncio.run(start())
        assert line.endswith("[31mred")
        assert line.isprintable()


class TestWhichOnes:
    def test_those_that_the_page_shows(self, analysis, finished):
        assert to_start(analysis, f"validate {finished}") == ["validate", str(finished)]
        assert to_start(analysis, f"{command(analysis)} --set gain=0.25")[-1] == "gain=0.25"

    @pytest.mark.parametrize(
        "asked",
        [
            "",
            "'",
            "validate",
            "validate {run} --yes",
            "validate {run} --trust",
            "validate {run}; rm -r {run}",
            "validate /other/run",
            # Shown, but not to be started: it goes on for long, or sets what stays.
            "tune --resume {run} --trials N",
            "apply {run}",
            "rm -r {run}",
            "{try_}",
            "{try_} --set gain=0.25 --trust",
            "{try_} --set gain=fast",
            "{try_} --set load=1.0",
            "{try_} --set gain=0.25 --set load=1",
            "{try_} --study gain=0.25",
            "{try_} gain=0.25",
        ],
    )
    def test_no_others(self, analysis, finished, asked):
        assert to_start(analysis, asked.format(run=finished, try_=command(analysis))) is None


class TestServed:
    def post(self, served, path, body="", **headers):
        control = served.origin | {"X-Control-Token": served.control_token("/runs/first")}
        return served.ask(path, method="POST", body=body, **control | headers)

    def test_a_command_of_the_page_runs(self, served):
        page = served.ask("/runs/first")[2]
        shown = re.findall(r"<code>(try [^<]*|replay [^<]*)</code>", page)
        status, _, text = self.post(served, "/runs/first/start", shown[0])
        assert status == 202, text
        version, news = -1, {"running": True}
        while news["running"]:
            news = json.loads(served.ask(f"/started?after={version}")[2])
            version = news["version"]
        assert news["command"] == shown[0]
        assert (news["exit_code"], len(news["lines"]) > 0) == (0, True), news["lines"]
        assert f"started from the page by 127.0.0.1: {shown[0]}" in served.said.read_text()

    def test_only_the_page_itself_may_ask(self, served):
        wrong = [{"Origin": "http://evil.example"}, {"X-Control-Token": "wrong"}]
        for path in ("/runs/first/start", "/started/stop"):
            for headers in wrong:
                answer = self.post(served, path, "validate first", **headers)
                assert answer[0] == 403, headers
        assert served.ask("/started?after=-1", token=False)[0] == 403

    def test_what_the_page_does_not_show_is_refused(self, served):
        status, _, said = self.post(served, "/runs/first/start", "rm -r /")
        assert (status, said) == (404, "404: the page of this run has no such command to start\n")
        assert self.post(served, "/runs/none/start", "validate none")[0] == 404
        assert served.ask("/started?after=x")[0] == 400

    def test_without_the_option_there_is_nothing_to_start(self, finished, tmp_path):
        shutil.copytree(finished, tmp_path / "runs" / "first")
        pages = ServedRuns(tmp_path / "runs")
        try:
            assert 'id="started"' not in pages.ask("/runs/first")[2]
            assert pages.ask("/runs/first/start", method="POST", body="")[0] in (404, 405)
            assert pages.ask("/started?after=-1")[0] == 404
        finally:
            pages.end()
