"""Print the linker's flags by which a C++ program finds the libraries of the ROS wheels.

A library of the wheels asks for Python, which a program has only if it is linked to it.
"""

import sys
import sysconfig
from pathlib import Path


def main() -> None:
    """Print them for the environment of this Python."""
    library, folder = map(str, sysconfig.get_config_vars("LDLIBRARY", "LIBDIR"))
    python = Path(folder, library)
    # Debian has it in a folder of the architecture.
    multiarch = Path(folder, str(sysconfig.get_config_var("MULTIARCH")), library)
    python = multiarch if multiarch.exists() else python
    if not sysconfig.get_config_var("Py_ENABLE_SHARED") or not python.exists():
        sys.exit(f"error: this Python has no shared library {library}, which C++ nodes need")
    packages = Path(sysconfig.get_path("purelib"))
    folders = [python.parent, Path(sys.prefix, "lib"), *sorted(packages.glob("ros_*.libs"))]
    print("-Wl,--no-as-needed", python, *(f"-Wl,-rpath,{folder}" for folder in folders))


if __name__ == "__main__":
    main()
