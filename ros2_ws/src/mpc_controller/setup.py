from pathlib import Path

from setuptools import find_packages, setup

NAME = "mpc_controller"


def shared(folder):
    """List the files below a folder for share/<package>, sub-folders kept."""
    folders = [path for path in Path(folder).glob("**/") if path.name != "__pycache__"]
    return [
        (f"share/{NAME}/{path}", [str(file) for file in sorted(path.iterdir()) if file.is_file()])
        for path in folders
    ]


setup(
    name=NAME,
    version="0.1.0",
    description="Kalman filter and model predictive controller of a feed axis, as a ROS 2 node",
    maintainer="bo_tuner maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"lib/{NAME}", ["scripts/mpc_controller"]),
        *shared("config"),
    ],
    # rclpy and the message packages are named in package.xml only: with a ROS installation they
    # are system packages, which pip does not see.
    python_requires=">=3.11",
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "osqp>=1.0,<2",
        "filterpy>=1.4.5,<3",
    ],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["mpc_controller = mpc_controller.__main__:main"]},
    zip_safe=False,
)
