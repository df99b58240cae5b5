"""JSON as the standard has it."""

import json


def strict(text):
    """Parse JSON that holds no NaN or Infinity, which are not part of it."""

    def refuse(constant):
        raise AssertionError(f"{constant} in {text}")

    return json.loads(text, parse_constant=refuse)
