"""What the documents say of parameters must be what the nodes declare."""

import re
from pathlib import Path

import pytest

from feed_axis_common.parameters import specifications
from milling_plant import settings as plant
from mpc_controller import settings as controller

INTERFACES = (Path(__file__).parents[1] / "docs" / "interfaces.md").read_text(encoding="utf-8")


def rows(node):
    section = re.search(rf"<!-- parameters: {node} -->\n(.*?)<!-- end -->", INTERFACES, re.DOTALL)
    lines = section.group(1).splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def shown(value):
    if isinstance(value, bool):
        return f"`{value}`".lower()
    return str(list(value) if isinstance(value, tuple) else value)


def permitted(spec):
    if spec.kind is bool:
        return "`true` or `false`"
    if spec.choices:
        return " or ".join(f"`{choice}`" for choice in spec.choices)
    return "" if spec.lower is None else f"{spec.lower:g} … {spec.upper:g}"


@pytest.mark.parametrize(
    ("node", "table", "defaults"),
    [
        ("mpc_controller", controller.ControllerSettings, controller.default_settings()),
        ("milling_plant", plant.PlantSettings, plant.default_settings()),
    ],
)
def test_parameter_tables(node, table, defaults):
    expected = [
        [
            f"`{spec.name}`",
            shown(getattr(defaults, spec.name)),
            permitted(spec),
            spec.unit,
            spec.text,
        ]
        for spec in specifications(table)
    ]
    assert rows(node) == expected
