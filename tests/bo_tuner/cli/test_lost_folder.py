"""A run whose folder, journal or lock is taken away ends before it writes anything more."""

import shutil

import pytest
from axis import node, write_study
from commands import Fork, finish
from waiting import count_in, wait_until


def take_folder(run):
    shutil.rmtree(run)


def move_folder(run):
    run.rename(run.with_name("moved"))


def replace_folder(run):
    run.rename(run.with_name("moved"))
    shutil.copytree(run.with_name("moved"), run)


def take_lock(run):
    (run / ".lock").unlink()


def replace_lock(run):
    (run / ".lock").unlink()
    (run / ".lock").touch()


def take_journal(run):
    (run / "journal.sqlite").unlink()


def replace_journal(run):
    shutil.copy(run / "journal.sqlite", run / "copy")
    (run / "copy").rename(run / "journal.sqlite")


def listing(run):
    """Names in a folder, but for what SQLite itself makes and removes beside its file."""
    names = [path.name for path in run.iterdir()] if run.exists() else []
    return sorted(name for name in names if not name.endswith(("-wal", "-shm")))


@pytest.mark.parametrize(
    ("take", "complaint"),
    [
        (take_folder, "the run folder was deleted or moved during the run"),
        (move_folder, "the run folder was deleted or moved during the run"),
        (replace_folder, "the run folder was deleted or moved during the run"),
        (take_lock, ".lock: was deleted or replaced during the run"),
        (replace_lock, ".lock: was deleted or replaced during the run"),
        (take_journal, "journal.sqlite: was deleted, moved or replaced during the run"),
        (replace_journal, "journal.sqlite: was deleted, moved or replaced during the run"),
    ],
)
def test_noticed_before_the_next_write(tmp_path, make_study, take, complaint):
    write_study(tmp_path, make_study(nodes=node("lost_axis")))
    cuts = tmp_path / "cuts"
    process = Fork(
        *("tune", "--study", "axis.yaml", "--backend", "inprocess"),
        folder=tmp_path,
        env={"CUTS": str(cuts), "HOLD": "3"},
    )
    wait_until(lambda: count_in(cuts) == 3, "the third evaluation", process)
    (run,) = (tmp_path / "runs").glob("function-*")
    take(run)
    left = listing(run)
    (tmp_path / "cuts.go").touch()
    code, _, err = finish(process)
    assert code == 1
    assert count_in(cuts) == 3
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    assert complaint in line
    if take in (take_folder, move_folder):
        assert not run.exists()
    elif take is replace_folder:
        assert listing(run) == left
