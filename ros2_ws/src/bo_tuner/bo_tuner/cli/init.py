"""``tune --init``: write a first study for the nodes that are running."""

import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from rich.table import Table

from bo_tuner.backends.ros.graph import opened_node
from bo_tuner.backends.ros.survey import survey
from bo_tuner.cli.exit_codes import EXIT_OK
from bo_tuner.cli.streams import ask, say_error
from bo_tuner.errors import BackendError, StudyError
from bo_tuner.interruption import Interruption
from bo_tuner.monitoring.display import plain_console, say
from bo_tuner.storage.atomic import writing
from bo_tuner.study import checks
from bo_tuner.study.first_study import first_study
from bo_tuner.study.offers import (
    ParameterOffer,
    parameter_offers,
    suggested_nodes,
    suggested_parameters,
)
from bo_tuner.study.seen import Seen, SeenNode
from bo_tuner.study.signal_offers import SignalOffer, signal_offers, suggested_signals
from bo_tuner.study.study_file import parse_study
from bo_tuner.text import counted, one_line, shown

SPAN = re.compile(r"([0-9]{1,6})(?:-([0-9]{1,6}))?")
FIRST_STUDY = Path("study.yaml")
Offer = TypeVar("Offer")
Row = Callable[[Offer], Sequence[str]]


class Chooser:
    """Lets the user choose of what was found: by an option, on a terminal, or else as suggested.

    Parameters
    ----------
    interruption
        Ends a question on a signal.
    """

    def __init__(self, interruption: Interruption) -> None:
        self._interruption = interruption

    def choose(
        self,
        what: str,
        given: Sequence[str] | None,
        offers: Sequence[Offer],
        suggested: Sequence[Offer],
        names: Callable[[Offer], Sequence[str]],
        row: Row[Offer],
    ) -> list[Offer]:
        """Return the offers that are chosen, at least one.

        Parameters
        ----------
        what
            Their name in the plural, which is that of the option too.
        given
            The option.
        offers, suggested
            All of them, and those to take unless the user says otherwise.
        names
            Names of an offer, one of which the option holds.
        row
            What to show of an offer.

        Raises
        ------
        StudyError
            If the option names what is not there, nothing is chosen, or the input ends.
        """
        if given is not None:
            return _named(what, given, offers, names)
        chosen = list(suggested)
        if offers and sys.stdin.isatty():
            chosen = self._asked(what, offers, suggested, row)
        if not chosen:
            known = [names(offer)[0] for offer in offers]
            hint = f"name some of {', '.join(known[:10])}" if known else "there are none"
            why = "nothing is chosen" if suggested or not known else "no name tells which to take"
            raise StudyError(f"--{what}: {why}; {hint}")
        return chosen

    def _asked(
        self, what: str, offers: Sequence[Offer], suggested: Sequence[Offer], row: Row[Offer]
    ) -> list[Offer]:
        table = Table(title=what, title_justify="left", show_header=False)
        for column in ("number", "suggested", "name", "now", "remark"):
            # Folded, since a name that is cut off tells nothing.
            table.add_column(column, overflow="fold")
        for index, offer in enumerate(offers, start=1):
            mark = "*" if offer in suggested else ""
            table.add_row(f"{index}", mark, *(one_line(cell) for cell in row(offer)))
        plain_console().print(table)
        while True:
            answer = ask(
                f"{what}: numbers such as 1 3-5, or Enter for those with *: ", self._interruption
            )
            if answer is None:
                raise StudyError(f"--{what}: the input has ended without an answer")
            if not answer:
                return list(suggested)
            try:
                return [offers[i - 1] for i in numbers(answer, len(offers))]
            except StudyError as error:
                say_error(str(error))


def numbers(text: str, most: int) -> list[int]:
    """Return the numbers from 1 to `most` that a text such as ``1 3-5`` lists, in order.

    Raises
    ------
    StudyError
        If it lists anything else.
    """
    found: set[int] = set()
    for word in text.replace(",", " ").split():
        match = SPAN.fullmatch(word)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= low <= high <= most:
            raise StudyError(f"expected numbers from 1 to {most}, found {checks.quoted(word)}")
        found |= set(range(low, high + 1))
    return sorted(found)


def _named(
    what: str,
    given: Sequence[str],
    offers: Sequence[Offer],
    names: Callable[[Offer], Sequence[str]],
) -> list[Offer]:
    chosen: list[Offer] = []
    for name in given:
        found = [offer for offer in offers if name in names(offer)]
        if not found:
            known = dict.fromkeys(n for o in offers for n in names(o))
            # Each offer once: with its node or topic if the name has one.
            alike = [other for other in known if (":" in other) == (":" in name)]
            hint = checks.suggestion(name, alike or known)
            raise StudyError(f"--{what}: there is no {checks.quoted(name)}; {hint}")
        chosen += [offer for offer in found if offer not in chosen]
    return chosen


def write_first_study(
    path: Path,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
    ros_arguments: Sequence[str],
    interruption: Interruption,
) -> int:
    """Write a first study for what runs; returns the exit code.

    Parameters
    ----------
    path
        File to write; it must not be there.
    nodes, parameters, signals
        What to take of each; None to ask on a terminal, or to take what is suggested.
    ros_arguments
        ``--ros-args`` of the node that looks.
    interruption
        Ends the command on a signal.

    Raises
    ------
    StudyError
        If the file is there, or something is named that is not there.
    BackendError
        If there is no node with parameters, or no topic with numbers.
    """
    _check_path(path)
    with opened_node(ros_arguments, interruption.check) as tuner:
        seen, notes = survey(
            tuner, lambda seen: _has(seen, nodes, parameters, signals), signals or ()
        )
    for note in notes:
        say(f"note: {note}")
    if not seen.nodes:
        raise BackendError("no node is left whose parameters can be had")
    say(f"nodes found: {', '.join(node.name for node in seen.nodes)}")
    if not seen.topics:
        raise BackendError("no topic has a number that could be a signal while the nodes are idle")
    tuned, chosen, recorded = _choose(seen, nodes, parameters, signals, Chooser(interruption))
    text = first_study(str(path), seen, tuned, chosen, recorded, ros_arguments)
    # Nothing is written that `tune --study` would refuse.
    parse_study(text, str(path))
    with writing(path):
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            _check_path(path)
    found = f"{counted(len(chosen), 'parameter')} and {counted(len(recorded), 'signal')}"
    say(f"{path}: {found}; now review it and")
    say("resolve each CHECK in it: bounds, what a run does, what good means; then")
    say(f"  {shlex.join(['tune', '--check', str(path), *ros_arguments])}")
    return EXIT_OK


def _has(
    seen: Seen,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
) -> bool:
    """Whether everything that is named is there."""
    names = {node.name for node in seen.nodes}
    known = {n for topic in seen.topics for o in signal_offers(topic) for n in _signal_names(o)}
    of_nodes: set[str] = set()
    for node in seen.nodes:
        offers, others = parameter_offers(node)
        for name in (*(offer.name for offer in offers), *others):
            of_nodes.update(_parameter_names(node.name, name))
    return (
        names.issuperset(name.lstrip("/") for name in nodes or ())
        and of_nodes.issuperset(parameters or ())
        and known.issuperset(signals or ())
    )


def _choose(
    seen: Seen,
    nodes: Sequence[str] | None,
    parameters: Sequence[str] | None,
    signals: Sequence[str] | None,
    chooser: Chooser,
) -> tuple[list[SeenNode], list[ParameterOffer], list[SignalOffer]]:
    """Choose nodes and parameters to tune, and signals to record."""
    offers, others = {}, {}
    for node in seen.nodes:
        offers[node.name], others[node.name] = parameter_offers(node)
    # Parameters that are named may be of any node.
    suggested = suggested_nodes(offers) if parameters is None else list(offers)
    tuned = chooser.choose(
        "nodes",
        None if nodes is None else [name.lstrip("/") for name in nodes],
        [node for node in seen.nodes if offers[node.name]],
        [node for node in seen.nodes if node.name in suggested],
        lambda node: [node.name],
        lambda node: [node.name, "", f"{counted(len(offers[node.name]), 'parameter')} to tune"],
    )
    of_nodes = [offer for node in tuned for offer in offers[node.name]]
    for node in tuned:
        for name, why in others[node.name].items():
            if set(parameters or ()).intersection(_parameter_names(node.name, name)):
                raise StudyError(f"--parameters: {name} of {node.name} is not offered: {why}")
    chosen = chooser.choose(
        "parameters",
        parameters,
        of_nodes,
        suggested_parameters(of_nodes),
        lambda offer: _parameter_names(offer.node, offer.name),
        lambda offer: [str(offer), shown(offer.fields["default"]), offer.remark],
    )
    near = suggested_signals(seen.topics, [node.name for node in tuned])
    recorded = chooser.choose(
        "signals",
        signals,
        [offer for topic in seen.topics for offer in signal_offers(topic)],
        near,
        _signal_names,
        lambda offer: [str(offer), shown(offer.topic.fields[offer.field]), offer.remark],
    )
    return tuned, chosen, recorded


def _parameter_names(node: str, name: str) -> list[str]:
    """Return what an option may call a parameter."""
    return [f"{node}:{name}", name]


def _signal_names(offer: SignalOffer) -> list[str]:
    """Return what an option may call a signal: its topic tells those that have a value."""
    of_topic = signal_offers(offer.topic)
    is_taken = offer.is_finite or not any(other.is_finite for other in of_topic)
    return [str(offer), offer.topic.name] if is_taken else [str(offer)]


def _check_path(path: Path) -> None:
    if path.suffix not in (".yaml", ".yml"):
        raise StudyError(f"--init: expected a file name that ends in .yaml, found {path}")
    if path.exists() or path.is_symlink():
        raise StudyError(f"{path}: already exists and is not overwritten; give another name")
    if not path.absolute().parent.is_dir():
        raise StudyError(f"{path}: there is no folder {path.parent}")
