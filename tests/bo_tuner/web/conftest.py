"""Runs with a page, held at an evaluation."""

import pytest
from axis import write_study
from commands import Fork, finish
from live_run import Run


@pytest.fixture
def held(tmp_path, make_study):
    """Function that starts a run with a page, and waits until it is held at an evaluation."""
    runs = []

    def begin(hold=9, *options, **environment):
        runs.append(Run(tmp_path, make_study(), hold, *options, **environment))
        return runs[-1]

    yield begin
    for run in runs:
        run.end()


@pytest.fixture(scope="module")
def run(tmp_path_factory, make_study):
    """A run with a page, held at its ninth evaluation."""
    run = Run(tmp_path_factory.mktemp("web"), make_study(), 9)
    yield run
    run.end()


@pytest.fixture(scope="module")
def beside(tmp_path_factory, make_study):
    """A run in progress in a folder with a finished one and a broken one."""
    folder = tmp_path_factory.mktemp("beside")
    write_study(folder, make_study())
    arguments = ("tune", "--backend", "inprocess", "--study", "axis.yaml", "--quiet")
    code, _, err = finish(Fork(*arguments, folder=folder))
    assert code == 0, err
    (folder / "runs" / "broken").mkdir()
    (folder / "runs" / "broken" / "journal.sqlite").write_text("no journal")
    run = Run(folder, make_study(), 9)
    run.state_when(lambda state, made: "trials" in made)
    (run.finished_one,) = (
        path.name
        for path in (folder / "runs").iterdir()
        if (path / "best.yaml").exists() and not path.is_symlink()
    )
    yield run
    run.end()
