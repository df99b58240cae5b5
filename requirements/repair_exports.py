"""Let the CMake files of the ROS wheels name what is there.

They name Python, NumPy and libraries of the machine on which the wheels were built. CMake refuses
a folder that does not exist, and nothing is linked to a library that is missing. The wheels have
these libraries beside those that need them.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy

BUILT = re.compile(
    r"/opt/python/cp\d+-cp\d+/(include/python[\d.]+|lib/[^;\"]*/numpy/_core/include)"
)
LINKED = re.compile(r'(?<=[;"])(?:/usr/lib64/libtinyxml2\.so|lttng-ust);')


def main() -> None:
    """Rewrite the files in the environment of this Python."""
    python = sysconfig.get_path("include")
    for path in Path(sys.prefix, "share").rglob("*.cmake"):
        text = path.read_text(encoding="utf-8")
        named = BUILT.sub(
            lambda match: python if match[1].startswith("include") else numpy.get_include(), text
        )
        named = LINKED.sub("", named)
        if named != text:
            path.write_text(named, encoding="utf-8")


if __name__ == "__main__":
    main()
