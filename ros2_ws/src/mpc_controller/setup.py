from pathlib import Path
from xml.etree import ElementTree

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
    version=ElementTree.parse("package.xml").findtext("version"),
    description="Kalman filter and model predictive controller of a feed axis, as a ROS 2 node",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="bo_tuner maintainers",
    maintainer_email="maintainers@example.com",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"lib/{NAME}", ["scripts/mpc_controller"]),
        *shared("config"),
    ],
    # rclpy and the message packages are no requirement: with a ROS installation they are system
    # packages, which pip does not see. Without one they are an extra.
    python_requires=">=3.11",
    install_requires=[
        "numpy>=1.26,<3",
        "scipy>=1.11,<2",
        "osqp>=1.0,<2",
        "filterpy>=1.4.5,<3",
    ],
    extras_require={
        "jazzy": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "kilted": ["ros-kilted-rclpy[fastrtps]", "ros-kilted-common-interfaces"],
        "test": ["pytest"],
    },
    entry_points={"console_scripts": ["mpc_controller = mpc_controller.__main__:main"]},
    zip_safe=False,
)
