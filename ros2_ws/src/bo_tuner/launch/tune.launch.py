"""The shipped studies as three processes: plant, controller, and the tuner attached to them."""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    OpaqueFunction,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

OPTIONS = {
    "study": ("benchmark", "Name of a shipped study, or path of a study file"),
    "trials": ("", "Number of trials; empty for the study's own"),
    "seed": ("", "Seed of the run; empty for the study's own"),
    "output": ("", "Folder for the results; empty for one below runs/"),
}


def tuner(context):
    """Return the tuner's node with the given options; the launch ends with it."""
    given = {option: LaunchConfiguration(option).perform(context) for option in OPTIONS}
    arguments = [
        text for option, value in given.items() if value for text in (f"--{option}", value)
    ]
    return [
        Node(
            package="bo_tuner",
            executable="tune",
            namespace=LaunchConfiguration("namespace"),
            arguments=["--attach", *arguments],
            output="screen",
            emulate_tty=True,
            on_exit=Shutdown(),
        )
    ]


def generate_launch_description():
    """Describe the closed loop, the tuner and the arguments they share."""
    closed_loop = PathJoinSubstitution(
        [FindPackageShare("milling_plant"), "launch", "closed_loop.launch.py"]
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of the three nodes"
            ),
            *(
                DeclareLaunchArgument(option, default_value=default, description=text)
                for option, (default, text) in OPTIONS.items()
            ),
            IncludeLaunchDescription(
                closed_loop,
                launch_arguments={"namespace": LaunchConfiguration("namespace")}.items(),
            ),
            OpaqueFunction(function=tuner),
        ]
    )
