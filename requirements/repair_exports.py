"""Let the CMake files of the ROS wheels name this Python and NumPy.

They name those of the machine on which the wheels were built, and CMake refuses a folder that does
not exist.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy

BUILT = re.compile(
    r"/opt/python/cp\d+-cp\d+/(include/python[\d.]+|lib/[^;\"]*/numpy/_core/include)"
)


def main() -> None:
    """Rewrite the files in the environment of this Python."""
    python = sysconfig.get_path("include")
    for path in Path(sys.prefix, "share").rglob("*.cmake"):
        text = path.read_text(encoding="utf-8")
        named = BUILT.sub(
            lambda match: python if match[1].startswith("include") else numpy.get_include(), text
        )
        if named != text:
            path.write_text(named, encoding="utf-8")


if __name__ == "__main__":
    main()
