"""A few examples of each kind of hostile input."""

import re
from pathlib import Path

import contracts
import pytest
import records
from hypothesis import HealthCheck, example, given, settings

import bo_tuner
import feed_axis_common
import milling_plant
import mpc_controller
from bo_tuner.errors import StudyError
from bo_tuner.study.study_file import parse_study

PACKAGES = (bo_tuner, feed_axis_common, milling_plant, mpc_controller)

FEW = settings(
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@FEW
@given(text=contracts.studies())
def test_a_study_with_changes(text):
    contracts.check_study(text)


@FEW
@given(data=contracts.bytes_of_studies())
@example(data=b"\xef\xbb\xbf" + contracts.TEXT.encode())
@example(data=b"a: " * 100_000)
@example(data=b"[" * 100_000)
@example(data=b"- " * 5_000 + b"x")
@example(data=b"x" * 2_000_000)
@example(data=b"\xff\xfea\0")
@example(data=b"%YAML 9.9\n---\n")
@example(data=b"? [a]\n: b")
@example(data=b"a: &x [*x]")
@example(data=b"!!python/object/apply:os.mkdir [owned]")
def test_a_study_file_of_any_bytes(tmp_path, data):
    contracts.check_study_bytes(data, contracts.below(tmp_path))


@pytest.mark.parametrize(
    "value",
    [
        "!!python/object/apply:os.mkdir [owned]",
        "!!python/name:os.mkdir",
        "!!python/object/new:os.mkdir {args: [owned]}",
        "!<tag:yaml.org,2002:python/object/apply:os.mkdir> [owned]",
        "!!binary b3duZWQ=",
        "!!timestamp 2001-01-01",
    ],
)
def test_nothing_in_a_study_is_constructed(tmp_path, monkeypatch, value):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(StudyError, match="tags"):
        parse_study(contracts.TEXT.replace("name: full", f"name: {value}", 1))
    assert list(tmp_path.iterdir()) == []


def test_yaml_is_loaded_safely_everywhere():
    folder = Path(bo_tuner.__file__).parent
    sources = [p for root in PACKAGES for p in Path(root.__file__).parent.rglob("*.py")]
    assert folder / "study" / "strict_yaml.py" in sources
    unsafe = re.compile(
        r"yaml\.(load|load_all|full_load|unsafe_load|Loader|FullLoader|UnsafeLoader)\b"
        r"|\b(pickle|marshal|shelve)\b|(?<![\w.])(eval|exec)\("
    )
    found = [path for path in sources if unsafe.search(path.read_text(encoding="utf-8"))]
    assert found == []


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder and what stands in it."""
    path = tmp_path_factory.mktemp("journal") / "run"
    return path, contracts.make_run(path)


def test_a_damaged_journal(tmp_path, run):
    path, record = run
    size = (path / "journal.sqlite").stat().st_size

    @FEW
    @given(damage=contracts.damages(size))
    def check(damage):
        contracts.check_journal(path, record, damage, tmp_path / "copy")

    check()


@FEW
@given(changes=contracts.parameter_values)
def test_parameter_values(changes):
    contracts.check_parameters(changes)


@FEW
@given(early=contracts.messages, late=contracts.messages)
def test_results_of_anybody(early, late):
    contracts.check_results(early, late)


@pytest.mark.slow
def test_mutated_records(tmp_path):
    """Values of other types under checksums that fit; benchmarks/fuzz.py reads 5,000."""
    whole = records.make_whole_run(tmp_path / "whole")
    for reader in records.READERS.values():
        reader(whole)
    answered = [records.check_record(whole, tmp_path / "copy", number) for number in range(60)]
    for reader in records.READERS:
        assert {True, False} == {each[reader] for each in answered}, reader
