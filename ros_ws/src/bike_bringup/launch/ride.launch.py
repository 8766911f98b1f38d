"""Rides with the shipped actor on a machine with ROS 2 Jazzy: `ros2 launch bike_bringup ride.launch.py`.

Starts the simulator free-running in real time, the policy node, the recorder, and on request RViz. When the simulator
ends, everything ends: each process gets SIGINT, and the nodes answer it by closing their files.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("bike_bringup"))


def arguments() -> list[DeclareLaunchArgument]:
    """The arguments of the command line, each with its default (`ros2 launch bike_bringup ride.launch.py -s`)."""
    return [
        DeclareLaunchArgument(
            "parameters",
            default_value=str(SHARE / "config" / "ride.yaml"),
            description="YAML file with the parameters of all nodes",
        ),
        DeclareLaunchArgument("namespace", default_value="bike", description="namespace of all nodes"),
        DeclareLaunchArgument("record", default_value="true", description="true: record the ride"),
        DeclareLaunchArgument("recording", default_value="ride.mcap", description="file that the recorder writes"),
        DeclareLaunchArgument("rviz", default_value="false", description="true: show the ride in RViz"),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describes the processes of one ride."""
    parameters, namespace = LaunchConfiguration("parameters"), LaunchConfiguration("namespace")
    return LaunchDescription(
        [
            *arguments(),
            # Not visible outside this machine, unless the shell asks for more.
            SetEnvironmentVariable(
                "ROS_AUTOMATIC_DISCOVERY_RANGE",
                EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
            ),
            Node(
                package="bike_sim",
                executable="sim_node",
                namespace=namespace,
                parameters=[parameters],
                output="screen",
                on_exit=Shutdown(reason="the simulator has ended"),
            ),
            Node(
                package="bike_policy",
                executable="drive",
                namespace=namespace,
                parameters=[parameters],
                output="screen",
            ),
            Node(
                package="bike_sim",
                executable="record",
                namespace=namespace,
                parameters=[parameters, {"path": LaunchConfiguration("recording")}],
                condition=IfCondition(LaunchConfiguration("record")),
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", str(SHARE / "rviz" / "ride.rviz")],
                parameters=[{"use_sim_time": True}],
                condition=IfCondition(LaunchConfiguration("rviz")),
                output="log",
            ),
        ]
    )
