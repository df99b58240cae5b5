"""Plant and controller of the milling scenario, ready for a tuner or for cuts by hand."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Describe the two nodes and the arguments that place and parametrize them."""
    arguments = [
        DeclareLaunchArgument(
            "namespace", default_value="", description="Namespace of both nodes, such as x_axis"
        )
    ]
    nodes = []
    for name in ("milling_plant", "mpc_controller"):
        parameters = f"{name}_parameters"
        arguments.append(
            DeclareLaunchArgument(
                parameters,
                default_value=PathJoinSubstitution(
                    [FindPackageShare(name), "config", f"{name}.yaml"]
                ),
                description=f"Parameter file of {name}, such as a tuner's best.yaml",
            )
        )
        nodes.append(
            Node(
                package=name,
                executable=name,
                name=name,
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration(parameters)],
                output="screen",
            )
        )
    return LaunchDescription([*arguments, *nodes])
