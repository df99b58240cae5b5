import json

import pytest

from bo_tuner.errors import OutputError
from tuning_benchmark.campaign.records import Records

VERSIONS = {"run/a/1": "v1", "run/a/2": "v1"}


def line(task, version="v1", **more):
    return {"task": task, "version": version, "result": None, **more}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "new" / "records.jsonl"


def test_records_are_read_again(file):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1", value=0.1))
    assert Records(file, VERSIONS).done == {"run/a/1": line("run/a/1", value=0.1)}


def test_a_session_sees_what_the_next_one_reads(file):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1", value=(1, 2)))
        assert records.done["run/a/1"]["value"] == [1, 2]


@pytest.mark.parametrize("torn", ["{", '{"task": "run/a/2", "version": "v1"}', "\x00\x00"])
def test_a_torn_last_line_is_dropped_and_written_over(file, torn):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1"))
    with file.open("a") as stream:
        stream.write(torn)
    with Records(file, VERSIONS) as records:
        assert list(records.done) == ["run/a/1"]
        records.add(line("run/a/2"))
    assert [json.loads(text)["task"] for text in file.read_text().splitlines()] == list(VERSIONS)


@pytest.mark.parametrize("torn", ["", "{"])
def test_what_another_campaign_has_written_since_is_not_cut_off(file, torn):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1"))
    with file.open("a") as stream:
        stream.write(torn)
    late = Records(file, VERSIONS)
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/2"))
    with pytest.raises(OutputError, match="another campaign has written to it"), late:
        pass
    assert list(Records(file, VERSIONS).done) == ["run/a/1", "run/a/2"]


def test_another_version_is_refused_with_both_versions_named(file):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1"))
    with pytest.raises(OutputError, match=r"run/a/1 of another version .*v1, now v2"):
        Records(file, {"run/a/1": "v2"})


def test_records_of_other_tasks_stay_and_do_not_matter(file):
    with Records(file, VERSIONS) as records:
        records.add(line("run/a/1"))
    with Records(file, {"run/b/1": "v2"}) as records:
        assert records.done == {}
        records.add(line("run/b/1", "v2"))
    assert list(Records(file, VERSIONS).done) == ["run/a/1"]


@pytest.mark.parametrize("content", ["[]\n", "no json\n", '{"task": "x"}\n'])
def test_what_is_no_record_is_refused_with_its_line(file, content):
    file.parent.mkdir()
    file.write_text(json.dumps(line("run/a/1")) + "\n" + content)
    with pytest.raises(OutputError, match="line 2 is not the record of a task"):
        Records(file, VERSIONS)


def test_what_is_not_a_number_is_refused_by_name(file):
    with Records(file, VERSIONS) as records, pytest.raises(ValueError, match="JSON"):
        records.add(line("run/a/1", value=float("nan")))


def test_a_folder_in_the_place_of_the_file_is_one_line(tmp_path):
    with pytest.raises(OutputError, match="cannot be read"):
        Records(tmp_path, VERSIONS)
