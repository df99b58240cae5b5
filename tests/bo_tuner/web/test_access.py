"""Who may read the page of a run in progress, and where it is."""

import contextlib
import socket

import pytest
from axis import write_study
from commands import Fork, finish
from waiting import wait_until

from bo_tuner.errors import OutputError
from bo_tuner.storage.record import read_run
from bo_tuner.web.address import listen


class TestWhoMayRead:
    def test_the_token_becomes_a_cookie(self, run):
        status, headers, _ = run.ask(f"/?token={run.token}", token=False)
        assert (status, headers["Location"]) == (302, "/")
        cookie = headers["Set-Cookie"]
        assert cookie.startswith(f"bo_tuner_{run.port}={run.token};")
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        status, headers, text = run.ask("/")
        assert status == 200
        assert headers["Content-Type"].startswith("text/html")
        # Neither page nor log tells it to the next reader.
        assert run.token not in text
        assert run.token not in (run.folder / "log" / "web.log").read_text()

    @pytest.mark.parametrize(
        "path",
        [
            "/",
            "/state?after=-1",
            "/runs/x/trials/0",
            "/study.yaml",
            "/runs",
            "/compare",
            "/runs.csv",
            "/runs/x",
            "/runs/x/files/study.yaml",
        ],
    )
    @pytest.mark.parametrize("query", ["", "token=", "token=wrong"])
    def test_others_are_refused(self, run, path, query):
        address = f"{path}{'&' if '?' in path else '?'}{query}"
        status, _, text = run.ask(address, token=False)
        assert status == 403
        assert len(text.splitlines()) == 1
        status, _, _ = run.ask(path, token=False, Cookie=f"bo_tuner_{run.port}=wrong")
        assert status == 403

    @pytest.mark.parametrize(
        "host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil:{port}", "127.0.0.1:1"]
    )
    def test_other_host_names_are_refused(self, run, host):
        status, _, _ = run.ask("/", Host=host.format(port=run.port))
        assert status == 403

    def test_localhost_is_not_another(self, run):
        assert run.ask("/", Host=f"localhost:{run.port}")[0] == 200

    @pytest.mark.parametrize("name", ["pause", "continue", "finish", "abort"])
    def test_it_takes_no_requests_unless_allowed(self, run, name):
        assert "data-token" not in run.ask("/")[2]
        headers = run.origin | {"X-Control-Token": run.token}
        status, _, text = run.ask(f"/requests/{name}", method="POST", **headers)
        assert (status, text) == (
            403,
            "403: the page is read-only; --web-control allows requests\n",
        )

    @pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
    def test_nothing_can_be_changed(self, run, method):
        before = read_run(run.folder)
        assert run.ask("/state?after=-1", method=method)[0] == 405
        assert read_run(run.folder) == before

    @pytest.mark.parametrize(
        "path",
        ["/study.yaml", "/../study.yaml", "/trials/0", "/runs/x/trials/0", "//evil.example/"],
    )
    def test_what_is_not_there(self, run, path):
        status, _, text = run.ask(path)
        assert status == 404
        assert len(text.splitlines()) == 1

    def test_a_version_that_is_none(self, run):
        assert run.ask("/state?after=x")[0] == 400

    def test_every_answer_forbids_frames_and_sniffing(self, run):
        for path in ("/", "/state?after=-1", "/nothing"):
            _, headers, _ = run.ask(path)
            assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers

    def test_only_this_machine_reaches_it(self, run):
        # All addresses of 127.0.0.0/8 are this machine's, but only one is listened to.
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", run.port), timeout=5.0)


class TestConnectionsWithoutARequest:
    def test_they_keep_no_reader_out_for_long(self, run):
        """Without a bound and a time limit, enough of them would take all descriptors."""
        with contextlib.ExitStack() as stack:
            for _ in range(300):
                stack.enter_context(socket.create_connection(("127.0.0.1", run.port)))

            def is_answered():
                try:
                    return run.ask("/")[0] == 200
                except OSError:
                    return False

            wait_until(is_answered, "the page while they are open")
        log = (run.folder / "log" / "web.log").read_text()
        assert log.count("more than 100 connections at a time") == 1
        assert "Traceback" not in log


class TestAddress:
    def test_a_port_in_use(self, tmp_path, make_study):
        write_study(tmp_path, make_study())
        with listen(0).socket as taken:
            port = taken.getsockname()[1]
            code, out, err = finish(
                Fork("tune", "--backend", "inprocess", "--study", "axis.yaml", "--web", port,
                      folder=tmp_path)
            )  # fmt: skip
        assert (code, out) == (2, "")
        assert err == (
            f"error: --web {port}: cannot listen on 127.0.0.1:{port}: Address already in use; "
            "expected a free port\n"
        )
        assert not (tmp_path / "runs").exists()

    def test_a_port_is_taken_by_one(self):
        with listen(0).socket as taken, pytest.raises(OutputError, match="expected a free port"):
            listen(taken.getsockname()[1])

    def test_no_two_tokens_are_alike(self):
        addresses = [listen(0) for _ in range(3)]
        for address in addresses:
            address.socket.close()
        assert len({address.token for address in addresses}) == 3
        # It is not shown by accident.
        assert all(address.token not in repr(address) for address in addresses)
