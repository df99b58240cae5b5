"""Parameter files in the form that ``--params-file`` takes."""

from collections.abc import Iterable, Mapping

import yaml

from bo_tuner.codec import checks
from bo_tuner.codec.reading import read
from bo_tuner.codec.rules import RosValues
from bo_tuner.errors import StudyError
from bo_tuner.storage.ros_reader import SECTION, read_sections
from bo_tuner.study.nodes import USE_SIM_TIME
from bo_tuner.study.step_values import senders
from bo_tuner.study.study import Study
from bo_tuner.text import one_line
from bo_tuner.trials import Value

NodeValues = Mapping[str, Mapping[str, object]]
"""Values by the name of the ROS node, then by its parameter."""

ANY_NAMESPACE = "/**/"


def node_values(study: Study, parameters: Mapping[str, Value]) -> dict[str, dict[str, object]]:
    """Return the values that the tuned nodes are given for a parameter set.

    What the study sets once on a tuned node is part of it: the parameter set was judged with it.
    `use_sim_time` is left out: on the machine the node would wait for the clock of a simulation.
    """
    typed = {name: study.parameters[name].checked(value) for name, value in parameters.items()}
    return _with_constants(study, typed, study.node_parameters(typed))


def all_values(study: Study) -> dict[str, dict[str, object]]:
    """Return the same for the default, with the parameters that it does not have."""
    return _with_constants(study, study.parameters, study.all_node_parameters)


def _with_constants(
    study: Study,
    names: Iterable[str],
    by_node: Mapping[str, Mapping[str, checks.ParameterValue]],
) -> dict[str, dict[str, object]]:
    values: dict[str, dict[str, object]] = {}
    for key in dict.fromkeys(study.parameters[name].node for name in names):
        if not key:
            continue
        spec = study.nodes[key]
        of_node = values.setdefault(spec.node, {})
        of_node.update(
            {name: _plain(item) for name, item in spec.parameters.items() if name != USE_SIM_TIME}
        )
    for key, of_set in by_node.items():
        values[study.nodes[key].node].update({name: _plain(v) for name, v in of_set.items()})
    return values


def sent_values(study: Study, parameters: Mapping[str, Value]) -> list[str]:
    """Say in a line each where the values of a set stand that no node has."""
    return [
        f"{name} = {value}: stands in {' and '.join(senders(study.run, study.nodes, name))}; put "
        "it there"
        for name, value in study.search_space().active(parameters).items()
        if not study.parameters[name].node
    ]


def to_yaml(values: NodeValues, notes: Iterable[str] = ()) -> str:
    """Return the text of a parameter file, with notes in comments ahead of it, a line each.

    A node is addressed by its name in any namespace, or in full if the study has that. Doubles keep
    their decimal point, since a node refuses an integer for one. Texts are quoted: ROS takes a
    plain ``y`` for true, and ``1e5`` or ``nan`` for a number.
    """
    nodes = {
        node if node.startswith("/") else f"{ANY_NAMESPACE}{node}": {
            SECTION: {k: _quoted(v) for k, v in of_node.items()}
        }
        for node, of_node in values.items()
    }
    comments = "".join(f"# {one_line(note)}\n" for note in notes)
    return comments + yaml.dump(nodes, Dumper=_Dumper, sort_keys=False)


def from_yaml(text: str) -> dict[str, dict[str, object]]:
    """Return the values in a text that `to_yaml` made."""
    values: dict[str, dict[str, object]] = {}
    try:
        for section in read_sections(text):
            node = section.name.removeprefix(ANY_NAMESPACE)
            if not section.name.startswith("/"):
                raise StudyError(
                    f"expected a section {ANY_NAMESPACE}<node>, found {checks.quoted(section.name)}"
                )
            # A study cannot set an array without an item, but a node may have had one.
            given = section.values
            read(Mapping[str, RosValues], {node: {k: v for k, v in given.items() if v != []}})
            values[node] = dict(given)
    except StudyError as error:
        place = "" if error.line is None else f"line {error.line}: "
        raise ValueError(f"{place}{error}") from error
    if not values:
        raise ValueError("expected a parameter file, found no section")
    return values


class _Text(str):
    """A text that is quoted."""

    __slots__ = ()


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(
    _Text, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style="'")
)


def _quoted(value: object) -> object:
    if isinstance(value, (list, tuple)):
        return [_quoted(item) for item in value]
    return _Text(value) if isinstance(value, str) else value


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value
