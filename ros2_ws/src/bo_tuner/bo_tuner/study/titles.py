"""What a reader calls a metric or a parameter: its label in the study, or else its name."""

import re
from collections.abc import Mapping
from typing import Annotated

from bo_tuner.codec import checks
from bo_tuner.codec.reading import Section
from bo_tuner.errors import StudyError
from bo_tuner.text import shown
from bo_tuner.trials import Value

LONGEST_LABEL = 60
"""Characters of a label; a table and the axis of a figure have room for no more."""


class Titled(Section):
    """Base of what has a name and may have a label, as fields of the derived class."""

    name: str
    label: str

    @property
    def title(self) -> str:
        """What screens call it; files, topics and options keep the name."""
        return self.label or self.name

    @property
    def title_and_name(self) -> str:
        """The same, with the name in brackets if it has a label: it is set by its name."""
        return f"{self.label} ({self.name})" if self.label else self.name


def titled_values(items: Mapping[str, Titled], values: Mapping[str, Value]) -> str:
    """Format values by their names in one line, each with the title of its item."""
    return ", ".join(f"{items[name].title} {shown(value)}" for name, value in values.items())


def mean_title(title: str) -> str:
    """Return what screens call the mean of what has a title, which may begin with the word."""
    return title if re.match(r"mean(?![^\W_])", title, re.IGNORECASE) else f"mean {title}"


def _label(value: object) -> str:
    label = checks.text(value)
    if len(label) > LONGEST_LABEL or label != label.strip() or not label.isprintable():
        raise StudyError(
            f"expected at most {LONGEST_LABEL} printable characters without spaces at the ends, "
            f"found {checks.show(label)}"
        )
    return label


Label = Annotated[str, _label]


def check_titles(items: Mapping[str, Titled]) -> None:
    """Check that a reader can tell the metrics, or the parameters, of a study apart.

    Raises
    ------
    StudyError
        If the label of one is what another is called.
    """
    for name, item in items.items():
        for other, called in items.items():
            if other != name and item.label and item.label in (other, called.label):
                raise StudyError(
                    f"expected a label of its own, found what {other} is called", (name, "label")
                )
