"""``apply --write``: a result in the parameter file that the user's nodes start with."""

import codecs
import difflib
import shlex
import sys
from pathlib import Path

from bo_tuner.cli.exit_codes import EXIT_INFEASIBLE, EXIT_OK, EXIT_USAGE
from bo_tuner.cli.streams import confirmed, say_error
from bo_tuner.deploy.own_file import with_values
from bo_tuner.errors import StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.storage.atomic import write_atomically
from bo_tuner.storage.parameter_file import NodeValues
from bo_tuner.storage.ros_reader import read_sections
from bo_tuner.storage.ros_sections import full_names
from bo_tuner.study.study_file import read_text

PREVIOUS = ".previous"


def write_back(
    path: Path, values: NodeValues, namespace: str, interruption: Interruption, *, yes: bool
) -> int:
    """Write values into a parameter file, of which nothing else changes; return the exit code.

    Shows the difference and asks, unless `yes`. The previous file is kept beside it.
    """
    # A link may lead to the file that is meant, such as into the sources of a workspace.
    place = path.resolve()
    if place.exists() and not place.is_file():
        # A pipe would be read twice.
        raise StudyError("expected a file", source=str(path))
    text = read_text(place, str(path))
    data = place.read_bytes()
    new = _edited(text, path, values, namespace)
    if data.startswith(codecs.BOM_UTF8):
        new = codecs.BOM_UTF8 + new
    if new == data:
        say(f"{path} has these values already; nothing to write")
        return EXIT_OK
    _show(text, new.decode("utf-8-sig"), path)
    if not yes:
        if not sys.stdin.isatty():
            say_error("error: no terminal to confirm on; use --yes")
            return EXIT_USAGE
        if not confirmed(f"write {path}? [y/N] ", interruption):
            say("nothing was written")
            return EXIT_INFEASIBLE
        if place.read_bytes() != data:
            say_error(f"error: {path} has changed meanwhile")
            return EXIT_INFEASIBLE
    interruption.check()
    previous = _unused(place)
    write_atomically(previous, data, like=place)
    write_atomically(place, new, like=place)
    say(f"written to {path}; nodes read it when they start")
    back = shlex.join(["mv", str(previous), str(place)])
    say(f"previous file: {previous}; restore it with: {back}")
    return EXIT_OK


def _edited(text: str, path: Path, values: NodeValues, namespace: str) -> bytes:
    try:
        sections = read_sections(text)
        full: dict[str, dict[str, object]] = {}
        for node, of_node in values.items():
            names = full_names(sections, node, namespace)
            if len(names) > 1:
                raise StudyError(
                    f"has {node} in several namespaces, {' and '.join(names)}: name one by "
                    "--ros-args -r __ns:=/NAME"
                )
            full[names[0]] = dict(of_node)
        return with_values(text, full).encode()
    except StudyError as error:
        raise error.located(str(path), error.line) from None


def _show(old: str, new: str, path: Path) -> None:
    console, (one, other) = plain_console(), (old.splitlines(), new.splitlines())
    for line in difflib.unified_diff(one, other, str(path), f"{path} (new)", lineterm="", n=2):
        # Not broken between words: it is to be read as it stands in the file.
        console.print(line, soft_wrap=True)


def _unused(path: Path) -> Path:
    """Return where the previous file goes: none that is kept already is replaced."""
    names = (f"{path.name}{PREVIOUS}{'' if n == 1 else f'.{n}'}" for n in range(1, 10_000))
    return next(unused for name in names if not (unused := path.with_name(name)).exists())
