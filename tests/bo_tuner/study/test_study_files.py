"""From a file to a study: lines in errors, scalars, names and paths, packages."""

import math
import os
import pickle
import signal
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest
from drive_text import STUDY

from bo_tuner import package_files
from bo_tuner.errors import BoTunerError, PackageFilesError, StudyError
from bo_tuner.interruption import Interrupted, Interruption
from bo_tuner.storage.parameter_set_file import read_parameter_set
from bo_tuner.study import strict_yaml
from bo_tuner.study.reference_table import read_table
from bo_tuner.study.study_file import (
    load_study,
    parse_study,
)


class TestLines:
    """Errors of a file name the file, the line and the path of keys."""

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (
                "bounds: [0, 10.0]",
                "bounds: [1.0, -5.0]",
                "5: parameters.gains.kp.bounds: lower bound 1.0 is not below upper bound -5.0",
            ),
            ("trials: 12, ", "", "22: budget.trials: missing"),
            ("  peak:", "  error:", "17: metrics.error: given twice, first in line 16"),
            ("order:", "ordr:", "10: ordr: unknown key; did you mean 'order'?"),
            ("name: drive\n", "name: drive\nname: b\n", "2: name: given twice, first in line 1"),
            ("[[window, span]]", "[[window,\n span]]\n extra", "12: not valid YAML:"),
            ("[[window, span]]", "[[window, span", "11: not valid YAML:"),
            ("name: drive", "name: drive\x07", "1: not a text file: character 0x7"),
            ("name: drive", "name: &a drive", "1: name: anchors and aliases"),
            ("name: drive", "name: *a", "1: name: anchors and aliases"),
            ("name: drive", "name: !!str drive", "1: name: tags (!) are not supported"),
            ("name: drive", "name: !!python/object/apply:os.getcwd []", "1: name: tags (!)"),
            ("name: drive", "? [a]\n: b", "1: expected text as a key"),
            ("name: drive", "1: b", "1: expected text as a key, found 1"),
            ("name: drive", "<<: {name: drive}", "1: <<: unknown key"),
            ("budget:", "---\nbudget:", "22: expected a single document"),
            ("name: drive", f"seed: {'9' * 5000}", "1: seed: integer of too many digits"),
            ("name: drive", f"name: {'[' * 5000}", "1: name: nested deeper than 20 levels"),
        ],
    )
    def test_message(self, old, new, message):
        assert old in STUDY
        with pytest.raises(StudyError) as caught:
            parse_study(STUDY.replace(old, new, 1), "mine.yaml")
        assert str(caught.value).startswith(f"mine.yaml:{message}")
        assert "\n" not in str(caught.value)
        assert isinstance(caught.value, (BoTunerError, ValueError))
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)

    def test_all_parts_are_checked_at_once(self):
        """In the order of the file, whatever the order of the checks."""
        text = (
            STUDY.replace("bounds: [0, 10.0]", "bounds: [1.0, -5.0]", 1)
            .replace("trials: 12, ", "", 1)
            .replace("  peak:", "  peek:", 1)
        )
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        assert str(caught.value).startswith("mine.yaml:5: parameters.gains.kp.bounds: lower")
        # A reference to what is not there is told along with parts that are wrong.
        current, worst, budget = map(str, caught.value.others)
        assert current.startswith("mine.yaml:20: constraints.current.metric: there is no metric")
        assert worst.startswith("mine.yaml:21: constraints.worst.metric: there is no metric")
        assert budget.startswith("mine.yaml:22: budget.trials: missing")
        with pytest.raises(StudyError) as caught:
            parse_study(
                STUDY.replace("  peak:", "  peek:", 1).replace("[window, span]", "[windw, span]"),
                "mine.yaml",
            )
        messages = [str(error) for error in (caught.value, *caught.value.others)]
        assert len(messages) > 1
        assert all("did you mean 'peek'" in m or "windw" in m for m in messages)

    def test_mistakes_of_all_kinds_are_told_in_one_go(self):
        """In keys, values and references, of parts that are right and of those that are not."""
        text = """\
name: position
sead: 3
nodes:
  pid: {node: pid}
parameters:
  kp: {node: pid, type: double, bounds: [0.1, 10.0], defalt: 0.5, scal: log}
  ki: {node: motor, type: double, bounds: [0.0, 2.0], default: 0.0}
signals:
  angle: {topic: /joint_states, field: "position[motor]", largest_gap: 0}
run:
  before:
    - publish: {topic: /set point, message: {data: 0.0}}
    - wait: -0.5
  start:
    - {}
  end: {after: yes}
metrics:
  error: {of: setpoint - angle, measure: iae}
  effort: {of: angle, measure: total}
objective: {metric: eror}
constraints:
  calm: {kind: chance, metric: effort, upper: 8.0, probability: 2}
  fast: {kind: worst_case, metric: speed, upper: 8.0}
budget: {initial_trials: 8}
"""
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        found = [str(error) for error in (caught.value, *caught.value.others)]
        expected = [
            "2: sead: unknown key",
            "6: parameters.kp.defalt: unknown key",
            "6: parameters.kp.scal: unknown key",
            "7: parameters.ki.node: there is no node 'motor'",
            "9: signals.angle.largest_gap: expected a number above 0",
            "12: run.before[0].publish.topic: expected a topic name",
            "13: run.before[1].wait: expected a number above 0",
            "15: run.start[0]: expected one of",
            "16: run.end.after: expected a number",
            "18: metrics.error.of: there is no signal or function 'setpoint'",
            "19: metrics.effort.measure: unknown 'total'",
            "20: objective.metric: there is no metric 'eror'; did you mean 'error'?",
            "22: constraints.calm.probability: expected a number between 0 and 1",
            "23: constraints.fast.metric: there is no metric 'speed'",
            "24: budget.trials: missing",
        ]
        assert [text[: len(f"mine.yaml:{e}")] for text, e in zip(found, expected, strict=True)] == [
            f"mine.yaml:{each}" for each in expected
        ]

    def test_a_section_that_is_missing_is_missed_by_nothing_that_refers_to_it(self):
        text = STUDY.replace("metrics:", "metrcs:", 1).replace("objective:", "objectve:", 1)
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        found = [str(error) for error in (caught.value, *caught.value.others)]
        assert found == [
            "mine.yaml:15: metrcs: unknown key; did you mean 'metrics'?",
            "mine.yaml:18: objectve: unknown key; did you mean 'objective'?",
        ]

    def test_fields_of_the_study_are_told_with_references(self):
        text = STUDY.replace("name: drive", "name: my drive\nseed: -1", 1)
        text = text.replace("{metric: error}", "{metric: eror}", 1)
        with pytest.raises(StudyError) as caught:
            parse_study(text, "mine.yaml")
        paths = [error.path for error in (caught.value, *caught.value.others)]
        assert paths == [("name",), ("seed",), ("objective", "metric")]

    def test_an_error_of_the_parameters_is_told_once(self):
        """Not of each part that refers to them."""
        with pytest.raises(StudyError) as caught:
            parse_study(STUDY.replace("[window, span]", "[windw, span]"), "mine.yaml")
        assert "windw" in str(caught.value)
        assert caught.value.others == ()

    def test_long_and_unprintable_keys_stay_on_one_short_line(self):
        with pytest.raises(StudyError) as caught:
            parse_study(f'"a\\n{"b" * 500}": 1', "mine.yaml")
        key, _, expected = str(caught.value).partition(": unknown key; expected one of ")
        assert key.startswith("mine.yaml:1: a\\nbbb")
        assert "\n" not in str(caught.value)
        # The rest grows with the sections that there are.
        assert len(key) < 100
        assert "objective" in expected


class TestScalars:
    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("1e-3", 1e-3), ("1.5E3", 1500.0), ("-.5", -0.5), ("3.", 3.0), ("12", 12),
            ("-7", -7), ("012", 12), ("on", "on"), ("yes", "yes"), ("1:30", "1:30"),
            ("2020-01-01", "2020-01-01"), ("true", True), ("~", None), ("", None),
            ("'12'", "12"), ('"1e3"', "1e3"), (".inf", math.inf), ("-.inf", -math.inf),
        ],
    )  # fmt: skip
    def test_core_schema(self, text, value):
        found = strict_yaml.parse(f"key: {text}").value["key"]
        assert found == value
        assert type(found) is type(value)

    def test_not_a_number(self):
        assert math.isnan(strict_yaml.parse(".nan").value)

    @pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n...\n"])
    def test_empty_file(self, text):
        with pytest.raises(StudyError, match=r"^mine.yaml: expected a mapping, found nothing$"):
            parse_study(text, "mine.yaml")


class TestFiles:
    def test_path(self, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_text(STUDY, encoding="utf-8")
        assert load_study(path) == load_study(str(path)) == parse_study(STUDY)

    def test_byte_order_mark_and_windows_line_ends(self, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_bytes(b"\xef\xbb\xbf" + STUDY.replace("\n", "\r\n").encode())
        assert load_study(path) == parse_study(STUDY)

    def test_name_wins_over_a_file_beside(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        Path("benchmark").write_text("nonsense", encoding="utf-8")
        assert load_study("benchmark").name == "benchmark"

    @pytest.mark.parametrize("name", ["benchmrk", "", "no such\nname"])
    def test_unknown_name_lists_the_shipped_ones(self, name):
        with pytest.raises(StudyError, match=r"shipped are benchmark, full") as e:
            load_study(name)
        assert "\n" not in str(e.value)

    @pytest.mark.parametrize(
        ("content", "problem"),
        [
            (b"\xff\xfe\x00n", "mine.yaml:1: expected UTF-8 text"),
            (b"a: 1\nb: \xe9", "mine.yaml:2: expected UTF-8 text"),
            (b"\x7fELF\x00\x01", "mine.yaml:1: not a text file"),
            (b"#" * 1_000_001, "mine.yaml: expected a file of at most 1 MB"),
        ],
    )
    def test_content_that_is_no_study(self, tmp_path, monkeypatch, content, problem):
        monkeypatch.chdir(tmp_path)
        Path("mine.yaml").write_bytes(content)
        with pytest.raises(StudyError) as caught:
            load_study("mine.yaml")
        assert str(caught.value).startswith(problem)

    def test_unreadable(self, tmp_path):
        with pytest.raises(StudyError, match=r"none.yaml: cannot be read: No such file"):
            load_study(tmp_path / "none.yaml")
        with pytest.raises(StudyError, match="cannot be read: Is a directory"):
            load_study(tmp_path)
        with pytest.raises(StudyError, match="cannot be read"):
            load_study("a\0b.yaml")
        with pytest.raises(StudyError, match="cannot be read: File name too long"):
            load_study("a" * 5000 + ".yaml")

    @pytest.mark.usefixtures("handlers")
    @pytest.mark.parametrize(
        "read",
        [
            load_study,
            lambda path: read_parameter_set(path, load_study("benchmark")),
            lambda path: read_table(path, "t", "r"),
        ],
        ids=["study", "parameters", "table"],
    )
    def test_a_pipe_into_which_nobody_writes_is_not_waited_for_beyond_a_signal(
        self, tmp_path, read
    ):
        os.mkfifo(tmp_path / "pipe.yaml")
        Interruption()
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Interrupted, match="SIGTERM"):
            read(tmp_path / "pipe.yaml")


def spec_at(package):
    """Function that finds a package in a folder."""
    return lambda name: ModuleSpec(name, None, origin=str(package / "__init__.py"))


class TestPackageFiles:
    def test_source_tree(self):
        assert (package_files.config_directory() / "studies" / "benchmark.yaml").is_file()

    def test_installed(self, tmp_path, monkeypatch):
        package = tmp_path / "lib" / "python3.12" / "site-packages" / "bo_tuner"
        shipped = tmp_path / "share" / "bo_tuner" / "config" / "studies"
        # Another package's folder must not be taken for ours.
        foreign = package.parent / "config" / "studies"
        for folder in (package, shipped, foreign):
            folder.mkdir(parents=True)
        monkeypatch.setattr(package_files, "find_spec", spec_at(package))
        assert package_files.config_directory() == shipped.parent

    def test_missing(self, tmp_path, monkeypatch):
        monkeypatch.setattr(package_files, "find_spec", spec_at(tmp_path / "a"))
        with pytest.raises(PackageFilesError, match="shipped studies are missing"):
            package_files.config_directory()
