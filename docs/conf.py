"""The documents as a site, by Sphinx: `make site`. Its pages ask for nothing from elsewhere."""

import dataclasses
import re
import shutil
import typing
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

import bo_tuner

project = "bo_tuner"
html_title = "Robust tuning of ROS 2 controllers"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
root_doc = "README"
exclude_patterns = ["records", "figures"]
html_theme = "furo"
html_copy_source = False
html_show_sphinx = False
# The notebooks are stored without what they put out.
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_ipywidgets_js = {}
myst_enable_extensions = ["attrs_inline"]
# As GitHub makes them: the links in the documents are to these.
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_default_options = {"members": True, "undoc-members": True, "show-inheritance": True}
napoleon_google_docstring = False
napoleon_use_ivar = True
nitpicky = False
# Lexers do not know all of console sessions with output.
suppress_warnings = ["misc.highlighting_failure", "myst.xref_ambiguous"]

# The documents by what a reader is after (diataxis.fr), in the order of the side bar.
CONTENTS = {
    "Tutorials": ["tutorial_first_run", "tutorial_unchanged_system", "tutorial_your_own_node"],
    "How to": [
        "live", "deploy", "identify", "guard", "safe_search", "procedure", "estimators",
        "systems", "workers", "cluster", "python", "campaigns", "security", "troubleshooting",
    ],
    "Recipes": [
        "recipes/ros2_control", "recipes/px4", "recipes/ardupilot", "recipes/gazebo_nav2",
        "recipes/launch_files", "recipes/zenoh", "recipes/mujoco",
    ],
    "Notebooks": [
        "notebooks/pid", "notebooks/worst_case", "notebooks/mpc_weights",
        "notebooks/gymnasium_task", "notebooks/estimators", "notebooks/reading_a_run",
    ],
    "Reference": ["commands", "study_keys", "study_file", "interfaces", "python_reference"],
    "Explanation": [
        "method", "certificate", "architecture", "examples", "results", "performance",
    ],
}  # fmt: skip

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = ROOT / "examples" / "notebooks"
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((\.\./[^)\s]+)\)")


def _copy_notebooks(app: Sphinx) -> None:
    """Have the notebooks among the documents: Sphinx looks nowhere else."""
    folder = Path(app.srcdir) / "notebooks"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(NOTEBOOKS, folder, ignore=shutil.ignore_patterns(".*"))


def _name_files(app: Sphinx, document: str, source: list[str]) -> None:
    """Name the files of the repository that are linked to, which the site does not have."""

    def named(match: re.Match[str]) -> str:
        text, target = match.groups()
        place = (ROOT / "docs" / document).parent / target.split("#")[0]
        path = str(place.resolve().relative_to(ROOT))
        if path.startswith("docs/"):
            return match[0]
        if (ROOT / path).parent == NOTEBOOKS:
            return f"[{text}](notebooks/{Path(path).name})"
        if not (ROOT / path).exists():
            raise ExtensionError(f"{document}: links to {target}, which is not there")
        return text if path in text else f"{text} (`{path}`)"

    source[0] = _LINK.sub(named, source[0])
    if document == root_doc:
        for caption, names in CONTENTS.items():
            entries = "\n".join(names)
            source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{entries}\n```\n"


def _leave_out_checks(app: Sphinx) -> None:
    """Have the types of fields in the reference, without the checks beside them."""
    for name in bo_tuner.__all__:
        for cls in getattr(getattr(bo_tuner, name), "__mro__", ()):
            if dataclasses.is_dataclass(cls):
                for holder in (cls, cls.__init__):
                    hints = typing.get_type_hints(holder)
                    own = holder.__annotations__
                    own.update({key: hints[key] for key in own if key in hints})


def setup(app: Sphinx) -> None:
    """Register what differs between the documents and the pages."""
    app.connect("builder-inited", _copy_notebooks)
    app.connect("builder-inited", _leave_out_checks)
    app.connect("source-read", _name_files)
