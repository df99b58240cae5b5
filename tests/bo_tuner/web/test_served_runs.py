"""The runs in a folder, served after their end: list, trials, files, and who may do what."""

import csv
import gzip
import io
import json
import os
import re
import shutil
import socket
import urllib.request
from dataclasses import asdict

import pytest
from pages import ServedRuns
from report_runs import run_axis, with_ends

from bo_tuner.report.analysis import Analysis
from bo_tuner.report.sections.what_if import forecast
from bo_tuner.storage.record import read_run
from bo_tuner.tuning.summary import with_summary
from bo_tuner.web import runs as runs_module
from bo_tuner.web.files import files_of
from bo_tuner.web.runs import Runs


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of a small object; nobody changes it."""
    return run_axis(tmp_path_factory.mktemp("finished"))


@pytest.fixture
def folder(finished, tmp_path):
    """A folder with three such runs, ``first`` to ``third``."""
    for name in ("first", "second", "third"):
        shutil.copytree(finished, tmp_path / "runs" / name)
        # As a copy it is as old as the others.
        (tmp_path / "runs" / name / "journal.sqlite").touch()
    return tmp_path / "runs"


@pytest.fixture
def served(folder):
    pages = ServedRuns(folder)
    yield pages
    pages.end()


class TestServed:
    def test_the_entrance_leads_to_the_list(self, served):
        status, headers, _ = served.ask(f"/?token={served.token}", token=False)
        assert (status, headers["Location"]) == (302, "/")
        assert f"bo_tuner_{served.port}={served.token};" in headers["Set-Cookie"]
        status, headers, _ = served.ask("/")
        assert (status, headers["Location"]) == (302, "/runs")
        listed = re.findall(r'<a href="/runs/(\w+)">', served.ask("/runs")[2])
        assert listed == ["third", "second", "first"]

    def test_others_are_refused(self, served):
        for path in ("/", "/runs", "/runs.csv", "/runs/first", "/runs/first/files/study.yaml"):
            assert served.ask(path, token=False)[0] == 403, path
        assert served.ask("/runs", Host=f"evil.example:{served.port}")[0] == 403
        assert served.ask("/runs", Host=f"192.0.2.7:{served.port}")[0] == 403

    def test_pages_are_light_and_need_nothing_else(self, served):
        for path, most in (("/runs", 150_000), ("/runs/first/trials/0", 300_000)):
            page = served.ask(path)[2]
            assert len(page.encode()) < most
            assert "<script src=" not in page
            packed = urllib.request.Request(
                f"http://127.0.0.1:{served.port}{path}?token={served.token}",
                headers={"Accept-Encoding": "gzip"},
            )
            with urllib.request.urlopen(packed) as answer:
                assert answer.headers["Content-Encoding"] == "gzip"
                text = gzip.decompress(answer.read()).decode()
            assert len(text) > 0.9 * len(page)

    def test_the_list_tells_what_is_new_without_what_is_around_it(self, served, folder):
        """Which the page asks for from time to time."""
        page = served.listing()
        (address,) = re.findall(r'data-news="([^"]+)"', page)
        status, _, news = served.ask(address)
        assert status == 200
        assert news.lstrip().startswith('<section id="runs"')
        assert news.strip() in page
        assert served.ask(address, token=False)[0] == 403
        assert served.ask("/news?page=7")[0] == 404
        assert served.ask("/news?page=x")[0] == 400
        shutil.copytree(folder / "first", folder / "fourth")
        news = served.ask(address)[2]
        listed = re.findall(r'<a href="/runs/(\w+)">', news)
        assert sorted(listed) == ["first", "fourth", "second", "third"]

    def test_the_models_predict_for_other_values(self, served, finished):
        page = served.ask("/runs/first")[2]
        (address,) = re.findall(r'data-forecasts="([^"]+)"', page)
        status, headers, text = served.ask(f"{address}?gain=0.3")
        assert (status, headers["Content-Type"]) == (200, "application/json")
        record = with_summary(read_run(finished), str)
        assert json.loads(text) == asdict(forecast(Analysis(record), {"gain": 0.3}))
        assert served.ask(f"{address}?gain=0.3", token=False)[0] == 403
        for query, code in (("gain=7", 404), ("load=1", 404), ("gain=high", 400)):
            assert served.ask(f"{address}?{query}")[0] == code, query
        assert served.ask("/runs/none/forecast?gain=0.3")[0] == 404

    def test_it_ends_with_ctrl_c(self, folder):
        pages = ServedRuns(folder)
        assert pages.end() == (130, "interrupted by SIGINT\n")
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", pages.port), timeout=5.0)

    def test_how_to_open_it_from_another_machine(self, served):
        _, way = served.said.read_text().splitlines()
        assert f"ssh -L {served.port}:127.0.0.1:{served.port} {socket.gethostname()}" in way

    def test_trials_with_their_neighbours(self, served, finished):
        last = len(read_run(finished).trials) - 1
        page = served.ask("/runs/second")[2]
        # From there the table of trials and the figures know the way.
        assert 'data-trials="/runs/second/trials/"' in page
        for number, neighbours in ((0, {1}), (1, {0, 2}), (last, {last - 1})):
            status, _, page = served.ask(f"/runs/second/trials/{number}")
            assert status == 200
            assert f"Trial {number}" in page
            led = re.findall(r'<a href="/runs/second/trials/(\d+)" rel="(prev|next)"', page)
            assert {int(other) for other, _ in led} == neighbours
        assert served.ask(f"/runs/second/trials/{last + 1}")[0] == 404

    def test_runs_with_their_neighbours(self, served):
        page = served.ask("/runs/second")[2]
        assert dict(re.findall(r'<a href="/runs/(\w+)" rel="(prev|next)"', page)) == {
            "first": "prev",
            "third": "next",
        }

    def test_names_that_are_no_unicode(self, served, folder):
        """As of a folder that an old system has made: it is a run, too."""
        folder.joinpath("second").rename(os.fsdecode(bytes(folder) + b"/caf\xe9"))
        assert 'href="/runs/caf%E9"' in served.ask("/runs")[2]
        status, _, page = served.ask("/runs/caf%E9")
        assert status == 200
        assert 'data-trials="/runs/caf%E9/trials/"' in page
        assert served.ask("/runs/caf%E9/trials/0")[0] == 200
        assert served.ask("/runs/caf%E9/files/study.yaml")[0] == 200
        assert 'href="/runs/caf%E9"' in served.ask("/runs/first")[2]
        assert served.ask("/runs.csv")[0] == 200
        assert served.ask("/runs?token=%E9", token=False)[0] == 400
        os.truncate(bytes(folder) + b"/caf\xe9/journal.sqlite", 4096)
        status, _, said = served.ask("/runs/caf%E9")
        assert (status, said.startswith("409: ")) == (409, True)

    def test_a_file_is_a_download(self, served, folder):
        page = served.ask("/runs/first")[2]
        assert 'href="/runs/first/files/deploy/parameters.yaml"' in page
        status, headers, text = served.ask("/runs/first/files/study.yaml")
        assert status == 200
        assert text == (folder / "first" / "study.yaml").read_text()
        assert headers["Content-Type"] == "application/octet-stream"
        assert headers["Content-Disposition"] == "attachment; filename*=UTF-8''study.yaml"

    def test_a_download_that_is_broken_off_is_no_fault(self, served, folder):
        (folder / "first" / "large").write_bytes(bytes(100_000_000))
        with socket.create_connection(("127.0.0.1", served.port)) as reader:
            asked = f"GET /runs/first/files/large?token={served.token} HTTP/1.1\r\n"
            reader.sendall(f"{asked}Host: 127.0.0.1:{served.port}\r\n\r\n".encode())
            assert reader.recv(1)
        # The next answer comes from the same loop, after that.
        assert served.ask("/runs")[0] == 200
        assert served.end() == (130, "interrupted by SIGINT\n")

    @pytest.mark.parametrize(
        "path",
        ["none", "deploy", "../second/study.yaml", "%2e%2e/second/study.yaml", ".lock",
         "/etc/passwd", "link", "aside/passwd"],
    )  # fmt: skip
    def test_what_is_no_file_of_the_run(self, served, folder, path):
        (folder / "first" / "link").symlink_to("/etc/passwd")
        (folder / "first" / "aside").symlink_to("/etc")
        assert served.ask(f"/runs/first/files/{path}")[0] == 404

    def test_all_runs_as_a_table(self, served, finished):
        text = served.ask("/runs.csv")[2]
        rows = {row["run"]: row for row in csv.DictReader(io.StringIO(text))}
        assert list(rows) == ["third", "second", "first"]
        (gain,) = [name for name in rows["first"] if name.startswith("gain [")]
        result = read_run(finished).result
        assert float(rows["first"][gain]) == result.parameters["gain"]

    def test_runs_that_have_ended_take_no_models(self, folder, monkeypatch):
        """There may be a thousand of them."""
        monkeypatch.setattr(Analysis, "models", property(lambda _: pytest.fail("models")))
        assert len(Runs(folder).table().splitlines()) == 4

    def test_what_has_no_number_is_an_empty_cell(self, tmp_path):
        """All draws of the default failed, so that it has no mean."""
        run = run_axis(tmp_path, **with_ends(0.4))
        (row,) = csv.DictReader(io.StringIO(Runs(run.parent).table()))
        cells = {name: cell for name, cell in row.items() if "mean error" in name}
        (tuned,) = [cell for name, cell in cells.items() if not name.startswith("default")]
        (default,) = [cell for name, cell in cells.items() if name.startswith("default")]
        # The least error that there is.
        assert float(tuned) >= 1.0
        assert default == ""


def test_a_long_list_has_pages(folder, monkeypatch):
    monkeypatch.setattr(runs_module, "MOST_RUNS", 2)
    runs = Runs(folder)
    first, second = runs.listing(0), runs.listing(1)
    assert re.findall(r'name="run" value="(\w+)"', first) == ["third", "second"]
    assert re.findall(r'name="run" value="(\w+)"', second) == ["first"]
    assert 'href="/runs?page=1" rel="next"' in first
    assert 'href="/runs?page=0" rel="prev"' in second
    assert runs.listing(2) is None


def test_files_of_the_folder_itself_come_first_and_logs_last(tmp_path):
    for path in ("log/a.log", "bags/b", "z.csv", ".lock", "journal.sqlite", "journal.sqlite-wal"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(path)
    names = [name for name, _ in files_of(tmp_path)]
    assert names == ["journal.sqlite", "z.csv", "bags/b", "log/a.log"]


class TestOtherMachines:
    @pytest.fixture
    def open_to_all(self, folder):
        pages = ServedRuns(folder, "--web-host", "0.0.0.0")
        yield pages
        pages.end()

    def test_the_address_is_theirs_to_open_and_its_risk_is_named(self, open_to_all):
        address, warning = open_to_all.said.read_text().splitlines()
        assert "//0.0.0.0" not in address
        assert "nothing is encrypted" in warning

    def test_numbers_are_ours_and_names_are_not(self, open_to_all):
        """A stranger's page reaches us by a name that it has resolve to us, never by a number."""
        for host, status in (("10.1.2.3", 200), ("evil.example", 403), ("[::1]", 403)):
            assert open_to_all.ask("/runs", Host=f"{host}:{open_to_all.port}")[0] == status
        assert open_to_all.ask("/runs", Host="10.1.2.3:1")[0] == 403
        assert open_to_all.ask("/runs", token=False)[0] == 403

    def test_all_interfaces_are_listened_to(self, open_to_all):
        # Another address of the loopback interface; by default only 127.0.0.1 is listened to.
        socket.create_connection(("127.0.0.2", open_to_all.port), timeout=5.0).close()


def test_a_list_of_many_runs_stands_there_before_all_of_them_are_read(folder, monkeypatch):
    """Each time that it is asked for, one run at least has been read."""
    monkeypatch.setattr(runs_module, "PATIENCE", 0.0)
    runs = Runs(folder)
    unread = re.compile(r' data-unread="(\d+)"')
    listed = [runs.listing(), runs.news(), runs.news()]
    assert [found and found[1] for found in map(unread.search, listed)] == ["2", "1", None]
    names = [re.findall(r'<a href="/runs/(\w+)">', page) for page in listed]
    assert [sorted(found) for found in names] == [["first", "second", "third"]] * 3
    assert [page.count("<td>…</td>") for page in listed] == [10, 5, 0]
    assert "7 of 7" in listed[0]


class TestTwoTrials:
    def test_side_by_side(self, folder, finished):
        page = Runs(folder).two_trials("first", [1, 2])
        one, other = read_run(finished).trials[1:3]
        difference = other.parameters["gain"] - one.parameters["gain"]
        (row,) = re.findall(r"<tr>\s*<th scope=\"row\">gain[^<]*</th>(.*?)</tr>", page, re.DOTALL)
        cells = [cell.strip() for cell in re.findall(r"<td[^>]*>([^<]*)</td>", row)]
        shown = [float(cell.split()[0]) for cell in cells]
        expected = [one.parameters["gain"], other.parameters["gain"], difference]
        assert shown == pytest.approx(expected, rel=1e-3)
        # In one context with one noise.
        assert {"trial 1", "trial 2"} <= set(re.findall(r'data-name="([^"]+)"', page))

    def test_on_the_server(self, served):
        trial = served.ask("/runs/first/trials/1")[2]
        (form,) = re.findall(r'<form action="([^"]+)"', trial)
        assert "form-action &#39;self&#39;" in trial or "form-action 'self'" in trial
        status, _, page = served.ask(f"{form}?trial=1&trial=2")
        assert status == 200
        assert "trials 1 and 2" in page
        assert served.ask(f"{form}?trial=1&trial=99")[0] == 404
        for query in ("", "?trial=1", "?trial=1&trial=x", "?trial=1&trial=2&trial=3"):
            assert served.ask(form + query)[0] == 400, query


def test_a_trial_offers_its_bags(folder):
    bag = folder / "first" / "bags" / "trial_0001"
    bag.mkdir(parents=True)
    (bag / "trial_0001_0.mcap").write_bytes(b"recorded")
    (folder / "first" / "bags" / "trial_0002").mkdir()
    (folder / "first" / "bags" / "trial_0002" / "trial_0002_0.mcap").write_bytes(b"other")
    runs = Runs(folder)
    page = runs.trial("first", 1)
    assert re.findall(r'<a href="([^"]+mcap)" download>', page) == [
        "/runs/first/files/bags/trial_0001/trial_0001_0.mcap"
    ]
    assert runs.file("first", "bags/trial_0001/trial_0001_0.mcap").read_bytes() == b"recorded"
