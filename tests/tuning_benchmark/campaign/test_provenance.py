import platform
import subprocess
import sys

import numpy
import pytest

from tuning_benchmark.campaign import provenance

FILES = {
    "__init__.py": "",
    "root.py": "import numpy\nfrom toolbox.near import thing\nfrom toolbox import late_one\n",
    "near.py": "def thing():\n    from toolbox.lazy import other\n",
    "lazy.py": "import toolbox_of_others\n",
    "late_one.py": "",
    "unused.py": "",
}


@pytest.fixture
def toolbox(tmp_path, monkeypatch):
    """A package of this test's own, fresh for each."""
    folder = tmp_path / "toolbox"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "toolbox"]:
        del sys.modules[name]
    forget()


def forget():
    provenance.imported.cache_clear()
    provenance._content.cache_clear()
    provenance._versions.cache_clear()


def test_all_that_a_module_imports_in_its_package_is_found(toolbox):
    found = provenance.imported(("toolbox.root",))
    names = ["", ".late_one", ".lazy", ".near", ".root"]
    assert list(found) == [f"toolbox{name}" for name in names]


def test_the_code_of_the_tuner_counts_wherever_a_task_starts(toolbox):
    (toolbox / "unused.py").write_text("from bo_tuner.tuning.loop import Tuning\nimport numpy\n")
    found = provenance.imported(("toolbox.unused",))
    assert {"bo_tuner.tuning.loop", "bo_tuner.trials", "toolbox.unused"} <= set(found)
    libraries = [text.split()[0] for text in provenance.versions(["toolbox.unused"])]
    assert "numpy" in libraries
    assert "bo_tuner" not in libraries


def test_digest_changes_with_what_runs_only(toolbox):
    before = provenance.digest(["toolbox.root"], "text")
    assert provenance.digest(["toolbox.root"], "other text") != before
    (toolbox / "unused.py").write_text("x = 1\n")
    forget()
    assert provenance.digest(["toolbox.root"], "text") == before
    (toolbox / "lazy.py").write_text("x = 1\n")
    forget()
    assert provenance.digest(["toolbox.root"], "text") != before


def test_digest_holds_the_versions_of_imported_libraries(toolbox, monkeypatch):
    before = provenance.digest(["toolbox.root"])
    python, *libraries = provenance.versions(["toolbox.root"])
    assert python == f"Python {platform.python_version()}"
    assert libraries == [f"numpy {numpy.__version__}"]
    monkeypatch.setattr(provenance.metadata, "version", lambda name: "0.0.1")
    forget()
    assert provenance.digest(["toolbox.root"]) != before


def git(folder, *arguments):
    identity = ["-c", "user.name=t", "-c", "user.email=t@example.com"]
    done = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


def test_commit_tells_whether_it_holds_the_code(toolbox):
    git(toolbox, "init", "--quiet")
    git(toolbox, "add", ".")
    git(toolbox, "commit", "--quiet", "-m", "all")
    head = git(toolbox, "rev-parse", "HEAD")
    assert provenance.commit(["toolbox.root"]) == head
    (toolbox / "near.py").write_text(FILES["near.py"] + "# changed\n")
    forget()
    assert provenance.commit(["toolbox.root"]) == f"{head} with 1 changed files"


def test_commit_is_unknown_without_a_repository(toolbox, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    assert provenance.commit(["toolbox.root"]) == "unknown"
