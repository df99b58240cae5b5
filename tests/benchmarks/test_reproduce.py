import json

import pytest
import reproduce
from reproduce import differences


def test_each_difference_is_named_by_its_keys():
    recorded = {"a": {"b": [1.0, 2.0]}, "c": None, "seconds": 1.0}
    now = {"a": {"b": [1.0, 2.0000000000000004]}, "d": 0, "seconds": 2.0}
    assert list(differences(recorded, now)) == [
        "a.b[1]: 2.0 on record, 2.0000000000000004 now",
        "c: only on record",
        "d: only now",
    ]
    assert list(differences(recorded, recorded | {"seconds": 3.0})) == []


@pytest.fixture
def records(tmp_path):
    """Folder with a record of the verdict on a parameter set, and that record."""
    name = "point/benchmark/optimum of the grid"
    lines = (reproduce.RECORDS / "paper.jsonl").read_text().splitlines()
    (record,) = (r for line in lines if (r := json.loads(line))["task"] == name)

    def write(record):
        (tmp_path / "paper.jsonl").write_text(json.dumps(record) + "\n")
        return tmp_path

    return write, record


def test_a_changed_number_is_found_and_an_equal_result_is_identical(records, monkeypatch, capsys):
    write, record = records
    monkeypatch.setattr(reproduce, "carry_out", lambda task: record)
    assert reproduce.reproduce("paper", write(record), ["point/*"])
    assert capsys.readouterr().out == "point/benchmark/optimum of the grid: identical\n"
    changed = json.loads(json.dumps(record))
    changed["result"]["truth"]["worst"] = 0.5
    assert not reproduce.reproduce("paper", write(changed), ["point/*"])
    assert "truth.worst: 0.5 on record" in capsys.readouterr().out


def test_a_pattern_without_a_record_is_bad_input(records, monkeypatch, capsys):
    write, record = records
    folder = write(record)
    monkeypatch.setattr("sys.argv", ["reproduce.py", "run/x/*", "--records", str(folder)])
    with pytest.raises(SystemExit) as stop:
        reproduce.main()
    assert stop.value.code == 2
    assert capsys.readouterr().err.endswith("no task matches run/x/*\n")
