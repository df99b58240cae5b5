"""Screens have one word for a thing: terms of code and literature stay in code and files."""

import ast
import importlib.resources
import re
from pathlib import Path

import pytest

WORDS = {
    "test run": r"evaluations?|evaluate[sd]?|draws",
    "best so far": r"incumbents?",
    "far off": r"outliers?|outlying",
    "model": r"surrogates?",
    "proven to stay within limits": r"shown to (be kept|hold|keep)",
    "not proven": r"not shown",
    "margin too small": r"may violate",
    "over the limit": r"violates \{\}",
}
"""A word of screens, and what they do not say in its place."""
NO_WORDS = re.compile(r"--[\w-]+|[\w.{}]+\.(csv|json)\b|`[^`]*`")
"""Names of options, files and keys, which have the terms of the field."""
KEPT = {
    # The methods of the paper, as the paper has them.
    "methods/registry.py": r"outlier detection",
    # A status on a topic, the name of which never changes.
    "monitoring/diagnostics.py": r"tuner: surrogate",
    # Outcomes of trials as files and topics have them.
    "study/limits.py": r"may violate|violates \{\}",
    # Tables of the journal.
    "storage/journal.py": r"(?s)CREATE TABLE.*|SELECT.*",
    # Expressions of a study, as mathematics has it.
    "numerics/expressions.py": r"cannot be evaluated.*",
}
"""Texts that are no screen's, by their module."""


def sentences(tree):
    """Texts of more than a word in a module, but for docstrings; ``{}`` stands for a value."""
    documentation = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}

    def within(node):
        if isinstance(node, ast.JoinedStr):
            yield "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values)
        elif isinstance(getattr(node, "value", None), str) and node not in documentation:
            yield node.value
        # A value that stands in a text may be chosen from further texts.
        for child in ast.iter_child_nodes(node):
            if not (isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)):
                yield from within(child)

    return [text for text in within(tree) if " " in text.strip()]


def modules():
    package = Path(str(importlib.resources.files("bo_tuner")))
    return [(str(p.relative_to(package)), p) for p in sorted(package.rglob("*.py"))]


@pytest.fixture(scope="module")
def texts():
    """What the modules may show, by the module."""
    found = []
    for name, path in modules():
        kept = KEPT.get(name, r"(?!)")
        for text in sentences(ast.parse(path.read_text(encoding="utf-8"))):
            found.append((name, NO_WORDS.sub("", re.sub(kept, "", text))))
    assert len(found) > 2000
    return found


@pytest.mark.parametrize("word", WORDS)
def test_screens_have_one_word_for_a_thing(texts, word):
    other = re.compile(rf"\b({WORDS[word]})(?!\w)", re.IGNORECASE)
    assert [(name, text) for name, text in texts if other.search(text)] == []


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ('f"an {a} of {b}"', ["an {} of {}"]),
        ("f\"it {x if x else 'took two evaluations'}\"", ["it {}", "took two evaluations"]),
        ('def f():\n    """Run two evaluations."""\n    return "one"', []),
        ('print("two " "words")', ["two words"]),
    ],
)
def test_texts_are_found_and_docstrings_are_not(source, expected):
    assert sentences(ast.parse(source)) == expected
