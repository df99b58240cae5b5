"""The run folder: never shared, complete, and readable by others."""

import datetime
import hashlib
import os
import re
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import yaml
from strict_json import strict

import bo_tuner
from bo_tuner.errors import OutputError
from bo_tuner.storage import run_folder as run_folder
from bo_tuner.storage.provenance import changed_sources, provenance, sources
from bo_tuner.storage.run_folder import RunFolder
from bo_tuner.study.study_file import load_study, parse_study

NOW = datetime.datetime(2026, 3, 1, 12, 30, 5)


@pytest.fixture
def same_second(monkeypatch):
    class Frozen(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return NOW

    monkeypatch.setattr(run_folder, "datetime", Frozen)


@pytest.fixture
def ended():
    """Number of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


class TestFolder:
    def test_runs_of_one_second_have_folders_of_their_own(self, tmp_path, make_study, same_second):
        output = tmp_path / "a" / "runs"
        found = [RunFolder.create(output, make_study()).path for _ in range(3)]
        assert [path.name for path in found] == [
            "function-20260301-123005",
            "function-20260301-123005-2",
            "function-20260301-123005-3",
        ]
        assert all(path.is_dir() for path in found)

    def test_holds_the_study_as_run(self, tmp_path):
        study = load_study("benchmark").replace(trials=3, seed=99)
        folder = RunFolder.create(tmp_path, study)
        assert parse_study((folder.path / "study.yaml").read_text()) == study

    def test_latest_follows_the_link(self, tmp_path, make_study):
        for _ in range(2):
            folder = RunFolder.create(tmp_path, make_study())
            folder.link_latest()
            link = tmp_path / "latest"
            assert link.resolve() == folder.path.resolve()
            # Relative, so that the whole may be moved.
            assert str(link.readlink()) == folder.path.name
        names = {path.name for path in tmp_path.iterdir()}
        assert {name for name in names if not name.startswith("function-")} == {"latest"}

    def test_latest_is_not_moved_by_a_run_that_does_not_start(self, tmp_path, make_study):
        first = RunFolder.create(tmp_path, make_study())
        first.link_latest()
        RunFolder.create(tmp_path, make_study())
        assert (tmp_path / "latest").resolve() == first.path.resolve()

    @pytest.mark.parametrize("kind", ["file", "folder", "link to a file", "link to nothing"])
    @pytest.mark.parametrize("when", ["before the run", "meanwhile"])
    def test_what_somebody_has_named_latest_stays_as_it_is(self, tmp_path, make_study, kind, when):
        runs, latest = tmp_path / "runs", tmp_path / "runs" / "latest"
        runs.mkdir()
        (tmp_path / "notes").write_text("mine")
        folder = RunFolder.create(runs, make_study()) if when == "meanwhile" else None
        if kind == "file":
            latest.write_text("mine")
        elif kind == "folder":
            latest.mkdir()
        else:
            latest.symlink_to(tmp_path / ("notes" if kind == "link to a file" else "gone"))

        def state():
            # Not when it was last read: to look at a link is to read it.
            found = latest.lstat()
            return found.st_ino, found.st_mode, found.st_mtime_ns, found.st_size

        before = state()
        with pytest.raises(OutputError, match=r"latest: cannot point to the run: it is no link to"):
            folder.link_latest() if folder else RunFolder.create(runs, make_study())
        assert state() == before
        assert len(list(runs.iterdir())) == (2 if folder else 1)
        assert (tmp_path / "notes").read_text() == "mine"

    def test_what_a_killed_process_has_left_half_written_goes_with_the_next(
        self, tmp_path, make_study, ended
    ):
        with closing(RunFolder.create(tmp_path, make_study())) as folder:
            folder.link_latest()
        left = [
            folder.path / f".summary.json.{ended}.new",
            folder.path / "log" / f".held_parameters.json.{ended}.new",
            tmp_path / f".latest.{ended}.new",
        ]
        kept = [
            # Of a process that runs, and of other programs.
            folder.path / f".report.html.{os.getpid()}.new",
            folder.path / "log" / ".cache.new",
            folder.path / "log" / f"notes.{ended}.new",
        ]
        for path in [*left[:2], *kept]:
            path.write_text("half")
        left[2].symlink_to(folder.path.name)
        with closing(RunFolder(folder.path)) as again:
            again.link_latest()
        assert not [path for path in left if os.path.lexists(path)]
        assert all(path.read_text() == "half" for path in kept)

    @pytest.mark.parametrize("below", ["", "sub/folder"])
    def test_output_is_a_file(self, tmp_path, make_study, below):
        file = tmp_path / "file"
        file.touch()
        with pytest.raises(OutputError, match="cannot write runs there") as caught:
            RunFolder.create(file / below, make_study())
        assert isinstance(caught.value, OSError)

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_output_is_read_only(self, tmp_path, make_study):
        tmp_path.chmod(0o500)
        with pytest.raises(OutputError, match="Permission denied"):
            RunFolder.create(tmp_path / "runs", make_study())


class TestParameterFile:
    def write(self, tmp_path, study, parameters):
        path = RunFolder.create(tmp_path, study).write_parameters(study, parameters)
        return path.read_text(), yaml.safe_load(path.read_text())

    @pytest.mark.parametrize("value", [3, -3.0, 1e-7, 1e22, 0.1 + 0.2])
    def test_a_double_keeps_its_point_and_bits(self, tmp_path, make_study, value):
        text, content = self.write(tmp_path, make_study(), {"gain": value})
        assert re.search(r"gain: -?\d+\.\d", text)
        read = content["/**/axis"]["ros__parameters"]["gain"]
        assert isinstance(read, float)
        assert read == value

    def test_an_integer_has_none(self, tmp_path):
        study = load_study("benchmark")
        defaults = study.search_space().defaults
        _, content = self.write(tmp_path, study, defaults | {"control_horizon": 7})
        values = content["/**/mpc_controller"]["ros__parameters"]
        constants = study.nodes["controller"].parameters
        assert values == defaults | {"control_horizon": 7} | constants
        assert isinstance(values["control_horizon"], int)

    def test_constants_of_the_study_belong_to_it(self, tmp_path, make_study):
        node = {"node": "group/axis", "result": "~/r", "parameters": {"mode": "fast", "q": [1.5]}}
        _, content = self.write(tmp_path, make_study(nodes={"axis": node}), {"gain": 0.5})
        assert content == {
            "/**/group/axis": {"ros__parameters": {"mode": "fast", "q": [1.5], "gain": 0.5}}
        }

    def test_the_clock_of_a_simulation_does_not(self, tmp_path, make_study):
        """A node on the machine would wait for a clock that nobody publishes there."""
        node = {"node": "axis", "result": "~/r", "parameters": {"use_sim_time": True, "rate": 10.0}}
        _, content = self.write(tmp_path, make_study(nodes={"axis": node}), {"gain": 0.5})
        assert content == {"/**/axis": {"ros__parameters": {"rate": 10.0, "gain": 0.5}}}

    def test_cannot_be_written(self, tmp_path, make_study):
        folder = RunFolder.create(tmp_path, make_study())
        (folder.path / "best.yaml").mkdir()
        with pytest.raises(OutputError, match=r"best\.yaml: cannot be written: Is a directory"):
            folder.write_parameters(make_study(), {"gain": 0.5})


class TestSummary:
    def test_what_is_no_number_is_null(self, tmp_path, make_study):
        folder = RunFolder.create(tmp_path, make_study())
        path = folder.write_json(
            "summary.json",
            {"a": float("nan"), "b": ({"c": float("inf")}, 1.5), "d": True, "e": "nan", "f": 3},
        )
        assert strict(path.read_text()) == {
            "a": None,
            "b": [{"c": None}, 1.5],
            "d": True,
            "e": "nan",
            "f": 3,
        }


def test_provenance_tells_what_makes_a_run_repeatable():
    record = provenance(load_study("benchmark").replace(seed=12), "inprocess", "III")
    assert record["study"] == "benchmark"
    assert record["seed"] == "12"
    assert record["backend"] == "inprocess"
    assert record["algorithm"] == "III"
    assert record["numpy"].count(".") == 2
    assert record["python"].startswith("3.")
    assert all(isinstance(value, str) for value in record.values())


class TestSources:
    @pytest.fixture
    def package(self, tmp_path, monkeypatch):
        folder = tmp_path / "their_axis"
        (folder / "inner").mkdir(parents=True)
        for path in ("__init__.py", "inner/deep.py"):
            (folder / path).write_text("VALUE = 1")
        monkeypatch.syspath_prepend(tmp_path)
        return folder

    @pytest.fixture
    def digests(self, make_study):
        study = make_study(
            nodes={"axis": {"node": "axis", "result": "~/r", "package": "their_axis",
                            "executable": "axis", "object": "their_axis.inner.deep:VALUE"}}
        )  # fmt: skip

        return lambda backend: sources(study, backend)

    @pytest.mark.parametrize("backend", ["ros", "inprocess"])
    def test_a_change_anywhere_in_a_package_of_the_study_shows(self, package, digests, backend):
        before = digests(backend)
        assert before.keys() == {"sources_sha256", "sources_sha256.their_axis"}
        (package / "inner" / "deep.py").write_text("VALUE = 2")
        after = digests(backend)
        assert changed_sources(before, after) == ["their_axis"]
        assert "their_axis" not in sys.modules

    def test_an_object_in_the_folder_of_the_study_has_one_imported_or_not(
        self, tmp_path, make_study, monkeypatch
    ):
        """What makes a certificate imports it, and what reads the certificate does not."""
        (tmp_path / "their_plate.py").write_text("VALUE = 1")
        study = make_study(
            folder=str(tmp_path),
            nodes={"axis": {"node": "axis", "result": "~/r", "object": "their_plate:VALUE"}},
        )
        before = sources(study, "inprocess")
        assert "their_plate" not in sys.modules
        assert str(tmp_path) not in sys.path
        with monkeypatch.context() as patch:
            patch.setattr(sys, "path", [*sys.path, str(tmp_path)])
            assert sources(study, "inprocess") == before
        (tmp_path / "their_plate.py").write_text("VALUE = 22")
        assert changed_sources(before, sources(study, "inprocess")) == ["their_plate"]

    def test_what_a_package_ships_beside_its_code_shows(self, tmp_path, digests, monkeypatch):
        """Such as the defaults of a plant; in the source tree, and installed."""
        source = tmp_path / "src" / "their_axis"
        installed = tmp_path / "lib" / "python3" / "site-packages"
        for code, config in (
            (source, source / "config"),
            (installed, tmp_path / "share" / "their_axis" / "config"),
        ):
            (code / "their_axis").mkdir(parents=True)
            (code / "their_axis" / "__init__.py").touch()
            config.mkdir(parents=True)
            (config / "defaults.yaml").write_text("gain: 1.0")
        (source / "package.xml").touch()
        for code, config in (
            (source, source / "config"),
            (installed, tmp_path / "share" / "their_axis" / "config"),
        ):
            with monkeypatch.context() as patch:
                patch.syspath_prepend(code)
                before = digests("ros")
                (config / "defaults.yaml").write_text("gain: 2.0")
                assert changed_sources(before, digests("ros")) == ["their_axis"]

    def test_the_digest_covers_the_whole_package(self):
        """Not one folder of it only."""
        whole = hashlib.sha256()
        folder = Path(bo_tuner.__file__).parent
        for path in sorted(folder.rglob("*.py")):
            whole.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
        assert sources(load_study("benchmark"), "ros")["sources_sha256"] == whole.hexdigest()

    def test_a_package_that_is_not_here_has_none(self, digests):
        assert digests("ros").keys() == {"sources_sha256"}
        assert changed_sources({"sources_sha256": "a", "sources_sha256.x": "b"}, {}) == [
            "bo_tuner", "x",
        ]  # fmt: skip
