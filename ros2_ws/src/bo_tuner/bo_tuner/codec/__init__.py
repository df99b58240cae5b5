"""One codec: dataclasses whose annotations are their checks, from and to plain data."""
