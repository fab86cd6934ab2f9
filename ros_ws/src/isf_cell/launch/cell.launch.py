"""The whole cell: simulated machine, planner, springback, force control, executive and, if asked for, the recorder.

    ros2 launch isf_cell cell.launch.py job:=examples/jobs/ren_cone.yaml record:=runs/cone
    ros2 launch isf_cell cell.launch.py machine:=false lockstep:=false

The executive brings the other nodes up when a part is asked for (action ``form_part``). With ``job`` that request is
sent at once; without it the cell waits. For a real machine start with ``machine:=false`` beside the cell's own driver.

Each cell of several is a ``namespace`` with its own /clock; /diagnostics is shared, its messages carry full names.
"""

import math
import os
from pathlib import Path

import yaml
from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

CLOCK = [("/clock", "clock")]
"""A machine in lockstep owns the time of its own cell: two of them must not publish on one topic."""

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
MIDDLEWARE_FILE = ("config", "fastdds.xml")

WAITING = (
    "no part is asked for: give job:=/path/of/a/job.yaml, or send a goal to the action form_part "
    "(ros2 interface show isf_msgs/action/FormPart)"
)


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes of a cell."""
    namespace = LaunchConfiguration("namespace")
    params_file = LaunchConfiguration("params_file")
    record = LaunchConfiguration("record")
    timing = {"lockstep": ParameterValue(LaunchConfiguration("lockstep"), value_type=bool)}

    arguments = [
        DeclareLaunchArgument(
            "job", default_value="", description="job file to form at once; empty: wait for form_part"
        ),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the cell"),
        DeclareLaunchArgument(
            "lockstep", default_value="true", description="machine and force control step together, as fast as they can"
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution([FindPackageShare("isf_cell"), "config", "cell.yaml"]),
            description="parameters of all nodes",
        ),
        DeclareLaunchArgument("record", default_value="", description="bag folder to write; empty: record nothing"),
        DeclareLaunchArgument("machine", default_value="true", description="start the simulated machine"),
    ]
    # Lifecycle nodes stay unconfigured here: the executive takes them through their transitions in order.
    managed = [
        LifecycleNode(
            package="isf_sim",
            executable="machine",
            name="machine",
            namespace=namespace,
            remappings=CLOCK,
            parameters=[params_file, timing],
            output="screen",
            condition=IfCondition(LaunchConfiguration("machine")),
        ),
        LifecycleNode(
            package="isf_planner",
            executable="planner",
            name="planner",
            namespace=namespace,
            remappings=CLOCK,
            parameters=[params_file],
            output="screen",
        ),
        LifecycleNode(
            package="isf_springback",
            executable="springback",
            name="springback",
            namespace=namespace,
            remappings=CLOCK,
            parameters=[params_file],
            output="screen",
        ),
        LifecycleNode(
            package="isf_force_ctrl",
            executable="force_ctrl",
            name="force_ctrl",
            namespace=namespace,
            remappings=CLOCK,
            parameters=[params_file, timing],
            output="screen",
        ),
    ]
    executive = Node(
        package="isf_cell",
        executable="executive",
        name="executive",
        namespace=namespace,
        remappings=CLOCK,
        parameters=[params_file, timing],
        output="screen",
    )
    recorder = Node(
        package="isf_analysis",
        executable="recorder",
        name="recorder",
        namespace=namespace,
        remappings=CLOCK,
        parameters=[params_file, {"output": record, "autostart": True}],
        output="screen",
        condition=IfCondition(NotEqualsSubstitution(record, "")),
    )
    request = OpaqueFunction(function=request_part)
    return LaunchDescription([*arguments, *middleware(), *managed, executive, recorder, request])


def middleware() -> list[Action]:
    """With what Fast DDS takes by itself a node waits seconds for its last messages to be acknowledged when it ends:
    longer than launch waits for it. A profile of the user's own stands."""
    if PROFILES in os.environ:
        return []
    return [SetEnvironmentVariable(PROFILES, PathJoinSubstitution([FindPackageShare("isf_cell"), *MIDDLEWARE_FILE]))]


def request_part(context: LaunchContext) -> list[Action]:
    """Ask the executive for the part of ``job``, when one is given; the request waits until the executive serves."""
    job = LaunchConfiguration("job").perform(context)
    if not job:
        return [LogInfo(msg=WAITING)]
    path = Path(job).resolve()
    if not path.is_file():
        raise RuntimeError(
            f"job:={job} is no file ({path}); give the path of a job file, absolute or from the working directory"
        )
    goal = {
        "job_text": path.read_text(encoding="utf-8"),
        "base_folder": str(path.parent),
        "support_force": math.nan,  # the job's own
    }
    action = "/".join([LaunchConfiguration("namespace").perform(context).rstrip("/"), "form_part"])
    command = ["ros2", "action", "send_goal", "--feedback", action, "isf_msgs/action/FormPart", yaml.safe_dump(goal)]
    return [ExecuteProcess(cmd=command, output="screen")]
