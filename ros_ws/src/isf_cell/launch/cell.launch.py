"""The whole cell: simulated machine or driver, planner, springback, force control, executive, and what looks at them.

    ros2 launch isf_cell cell.launch.py job:=examples/jobs/ren_cone.yaml record:=runs/cone rviz:=true
    ros2 launch isf_cell cell.launch.py machine:=false lockstep:=false

The executive brings the other nodes up when a part is asked for (action ``form_part``). With ``job`` that request is
sent at once; without it the cell waits. For a real machine start with ``machine:=false`` beside the cell's own driver.
``ros2 launch isf_cell cell.launch.py --show-args`` lists the arguments.

Each cell of several is a ``namespace`` with its own /clock, /tf and /tf_static; /diagnostics is shared, its messages
carry full names. Which nodes there are stands in ``isf_cell.processes.cell_nodes``.
"""

import json
import math
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import yaml
from isf_cell.processes import cell_nodes
from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

PROFILES, RANGE = "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCAL_FILE, OPEN_FILE, LINK_FILE = (("config", f"fastdds{which}.xml") for which in ("_local", "", "_link"))
OPEN, BY_PROFILE, LOCAL = "SUBNET", "SYSTEM_DEFAULT", "LOCALHOST"
FAST_DDS = "rmw_fastrtps"
RVIZ_FILE = ("layouts", "cell.rviz")
RESPAWN_DELAY = 2.0  # s, so that a node which cannot start does not fill the log

YES, NO = "true", "false"
ARGUMENTS: dict[str, dict[str, Any]] = {
    "job": {"default_value": "", "description": "job file to form at once; empty: wait for form_part"},
    "rig": {"default_value": "", "description": "rig (name or path) that is shown, and has load cells, without a job"},
    "namespace": {"default_value": "", "description": "namespace of the cell"},
    "machine": {
        "default_value": YES,
        "choices": [YES, NO],
        "description": "start the simulated machine; false: a driver is there",
    },
    "lockstep": {
        "default_value": YES,
        "choices": [YES, NO],
        "description": "machine and force control step together, as fast as they can; false: by the clock",
    },
    "nodes": {"default_value": "", "description": "start only these, with spaces between; empty: all"},
    "together": {
        "default_value": "",
        "description": "these, with spaces between, in one process: of planner, springback, executive, "
        "cell_state_publisher",
    },
    "params_file": {
        "default_value": PathJoinSubstitution([FindPackageShare("isf_cell"), "config", "cell.yaml"]),
        "description": "parameters of all nodes",
    },
    "log_level": {
        "default_value": "info",
        "choices": ["debug", "info", "warn", "error", "fatal"],
        "description": "from which on nodes write to their log",
    },
    "use_sim_time": {
        "default_value": "auto",
        "choices": ["auto", YES, NO],
        "description": "clock of the nodes is that of the machine; auto: in lockstep that of what shows the cell",
    },
    "load_cells": {
        "default_value": "auto",
        "choices": ["auto", "none", "1", "2", "1 2"],
        "description": "tools whose wrench a node load_cell_k makes of raw readings; auto: as rig and files below say",
    },
    "load_cell_file_1": {"default_value": "", "description": "file of isf calibrate-cell for the cell of tool_1"},
    "load_cell_file_2": {"default_value": "", "description": "the same for tool_2"},
    "record": {"default_value": "", "description": "bag folder to write; empty: record nothing"},
    "checkpoint": {
        "default_value": "",
        "description": "folder to keep the part in after every contour, to go on with it (resume); empty: none",
    },
    "cell_state": {
        "default_value": YES,
        "choices": [YES, NO],
        "description": "publish frames, joint states, description and sheet for viewers",
    },
    "robot_state_publisher": {
        "default_value": NO,
        "choices": [YES, NO],
        "description": "it makes the frames instead of cell_state_publisher; needs job or rig",
    },
    "ros2_control": {
        "default_value": NO,
        "choices": [YES, NO],
        "description": "controller_manager drives the axes; needs job or rig, and lockstep:=false",
    },
    "frame_prefix": {"default_value": "", "description": "before the name of every frame, on the /tf of all cells"},
    "rviz": {"default_value": NO, "choices": [YES, NO], "description": "start RViz with the layout of the cell"},
    "link": {
        "default_value": NO,
        "choices": [YES, NO],
        "description": "other nodes of the cell are on other computers: they are found, and sent small datagrams",
    },
    "respawn": {
        "default_value": NO,
        "choices": [YES, NO],
        "description": "start planner, springback and cell_state_publisher anew when they have ended",
    },
}

WAITING = (
    "no part is asked for: give job:=/path/of/a/job.yaml, or send a goal to the action form_part "
    "(ros2 interface show isf_msgs/action/FormPart)"
)


def generate_launch_description() -> LaunchDescription:
    """Arguments and nodes of a cell."""
    arguments = [DeclareLaunchArgument(name, **said) for name, said in ARGUMENTS.items()]
    return LaunchDescription(
        [*arguments, *(OpaqueFunction(function=step) for step in (middleware, start_nodes, request_part))]
    )


def middleware(context: LaunchContext) -> list[Action]:
    """A cell stays on its computer, unless there is a ``link`` or the user says otherwise. With what Fast DDS takes by
    itself a node waits seconds for its last messages to be acknowledged when it ends: longer than launch waits for it.
    A profile of the user's own stands, but for LINK_FILE."""
    share = FindPackageShare("isf_cell")
    if LaunchConfiguration("link").perform(context) == YES:
        wanted = {PROFILES: PathJoinSubstitution([share, *LINK_FILE]), RANGE: OPEN}
        return [SetEnvironmentVariable(name, value) for name, value in wanted.items()]
    # LOCALHOST would add shared memory to LOCAL_FILE, which says why not; other middleware, and other profiles, need it
    fast_dds = os.environ.get("RMW_IMPLEMENTATION", FAST_DDS).startswith(FAST_DDS)
    reach = os.environ.get(RANGE, BY_PROFILE if fast_dds and PROFILES not in os.environ else LOCAL)
    file = OPEN_FILE if reach == OPEN else LOCAL_FILE
    wanted = {PROFILES: PathJoinSubstitution([share, *file]), RANGE: reach}
    return [SetEnvironmentVariable(name, value) for name, value in wanted.items() if name not in os.environ]


def start_nodes(context: LaunchContext) -> list[Action]:
    """The nodes that the arguments ask for."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    described = describe(context, asked)
    choice = choose(asked, described)
    nodes = cell_nodes.cell_nodes(choice)
    if only := asked["nodes"].split():
        unknown = sorted(set(only) - {node.name for node in nodes})
        if unknown:
            raise RuntimeError(
                f"nodes:={asked['nodes']}: the cell has no {', '.join(unknown)}; "
                f"it has {', '.join(node.name for node in nodes)}"
            )
        nodes = [node for node in nodes if node.name in only]
    together = [node for node in nodes if node.name in asked["together"].split()]
    actions = [make(node, asked) for node in nodes if node not in together]
    actions += make_together(together, asked)
    return [*actions, *viewers(asked, choice, described), *drives(asked, described)]


def choose(asked: dict[str, str], described: dict[str, Any]) -> cell_nodes.CellChoice:
    """What the arguments say of the cell."""
    files = {k: str(Path(path).resolve()) for k in (1, 2) if (path := asked[f"load_cell_file_{k}"])}
    if asked["load_cells"] == "auto":
        cells = tuple(sorted({*described.get("spindle_cells", []), *files}))
    else:
        cells = tuple(int(word) for word in asked["load_cells"].replace("none", "").split())
    return cell_nodes.CellChoice(
        lockstep=asked["lockstep"] == YES,
        machine=asked["machine"] == YES,
        load_cells=cells,
        tilts=described.get("tilts", False),
        cell_files=files,
        rig=described.get("rig", ""),
        bag=asked["record"],
        checkpoint=str(Path(asked["checkpoint"]).resolve()) if asked["checkpoint"] else "",
        viewers=asked["cell_state"] == YES,
        job=str(Path(asked["job"]).resolve()) if asked["job"] else "",
        frame_prefix=asked["frame_prefix"],
        own_frames=own_frames(asked),
        publish_tf=asked["robot_state_publisher"] == NO,
        ros2_control=asked["ros2_control"] == YES,
    )


def own_frames(asked: dict[str, str]) -> bool:
    """Cells of several have frames of the same names: apart by their topics, unless they are by a prefix."""
    return bool(asked["namespace"].strip("/")) and not asked["frame_prefix"]


def describe(context: LaunchContext, asked: dict[str, str]) -> dict[str, Any]:
    """What ``isf describe`` says of job or rig: path of the rig file, tools with spindle cells, text of the URDF."""
    subject = asked["job"] or asked["rig"]
    if not subject:
        for name in ("robot_state_publisher", "ros2_control"):
            if asked[name] == YES:
                raise RuntimeError(f"{name}:=true needs job:= or rig:=, to know what to describe")
        return {}
    more = ["--ros2-control"] if asked["ros2_control"] == YES else []
    program = PathJoinSubstitution([FindPackagePrefix("isf_cell"), "lib", "isf_cell", "isf"]).perform(context)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.urdf"
        done = subprocess.run(
            [program, "describe", subject, "-o", str(path), "--json", *more],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise RuntimeError(f"{'job' if asked['job'] else 'rig'}:={subject} cannot be used:\n{done.stderr.strip()}")
        said = json.loads(done.stdout)
        if more:
            said["controllers"] = Path(said["controllers"]).read_text(encoding="utf-8")
        return {**said, "text": path.read_text(encoding="utf-8")}


def make(node: cell_nodes.CellNode, asked: dict[str, str]) -> Action:
    """One node of the cell as launch starts it."""
    shows = node.name == "cell_state_publisher"
    common: dict[str, Any] = {
        "package": node.package,
        "executable": node.executable,
        "name": node.name,
        "namespace": asked["namespace"],
        "remappings": [cell_nodes.OWN_CLOCK, *node.remap],
        "parameters": [asked["params_file"], {**node.parameters, "use_sim_time": sim_time(asked, shows=shows)}],
        "ros_arguments": ["--log-level", asked["log_level"], *cell_nodes.enclave_arguments(node.name)],
        "output": "screen",
        "respawn": asked["respawn"] == YES and node.keeps_nothing,
        "respawn_delay": RESPAWN_DELAY,
    }
    # Lifecycle nodes stay unconfigured here: the executive takes them through their transitions in order.
    return LifecycleNode(**common) if node.managed else Node(**common)


def make_together(nodes: list[cell_nodes.CellNode], asked: dict[str, str]) -> list[Action]:
    """Those ``nodes`` in one process."""
    apart = sorted(set(asked["together"].split()) - {node.name for node in nodes})
    if apart:
        raise RuntimeError(f"together:={asked['together']}: nothing starts {', '.join(apart)}")
    if not nodes:
        return []
    if cell_nodes.enclave_arguments(nodes[0].name):
        raise RuntimeError("together: one process has one security enclave, and the policy has one for each node")
    respawn = asked["respawn"] == YES and all(node.keeps_nothing for node in nodes)
    if asked["respawn"] == YES and any(node.keeps_nothing for node in nodes) and not respawn:
        kept = ", ".join(node.name for node in nodes if not node.keeps_nothing)
        raise RuntimeError(f"together with respawn:=true: {kept} cannot be started anew in mid-part; leave it out")
    own: list[str] = []
    for node in nodes:
        simulated = sim_time(asked, shows=node.name == "cell_state_publisher")
        for name, value in {**node.parameters, "use_sim_time": simulated}.items():
            own += ["-p", f"{node.name}:{name}:={json.dumps(value)}"]
        for before, after in node.remap:
            own += ["-r", f"{node.name}:{before}:={after}"]
    return [
        Node(
            package="isf_cell",
            executable="together",
            arguments=[node.name for node in nodes],
            namespace=asked["namespace"],
            remappings=[cell_nodes.OWN_CLOCK],
            parameters=[asked["params_file"]],
            ros_arguments=["--log-level", asked["log_level"], *own],
            output="screen",
            respawn=respawn,
            respawn_delay=RESPAWN_DELAY,
        )
    ]


def sim_time(asked: dict[str, str], *, shows: bool) -> bool:
    """Whether a node's clock is that of the machine; ``shows``: it shows what happens, with the stamps of messages."""
    if asked["use_sim_time"] == "auto":
        return shows and asked["lockstep"] == YES and asked["machine"] == YES
    return asked["use_sim_time"] == YES


def viewers(asked: dict[str, str], choice: cell_nodes.CellChoice, described: dict[str, Any]) -> list[Action]:
    """robot_state_publisher and RViz, which are no part of this workspace."""
    common: dict[str, Any] = {
        "namespace": asked["namespace"],
        "remappings": [cell_nodes.OWN_CLOCK, *(cell_nodes.OWN_FRAMES if choice.own_frames else ())],
        "output": "screen",
    }
    time = {"use_sim_time": sim_time(asked, shows=True)}
    actions: list[Action] = []
    if asked["robot_state_publisher"] == YES:
        about = {"robot_description": described["text"], "frame_prefix": asked["frame_prefix"], **time}
        name = "robot_state_publisher"
        actions.append(Node(package=name, executable=name, name=name, parameters=[about], **common))
    if asked["rviz"] == YES:
        layout = PathJoinSubstitution([FindPackageShare("isf_description"), *RVIZ_FILE])
        fixed = ["-f", f"{asked['frame_prefix']}sheet"]
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                name="rviz",
                arguments=["-d", layout, *fixed],
                parameters=[time],
                **common,
            )
        )
    return actions


def drives(asked: dict[str, str], described: dict[str, Any]) -> list[Action]:
    """controller_manager and its controllers, with the parameter file of the rig; it takes the description from
    cell_state_publisher. It gets no name: a process gives that to all its nodes, and controllers are some."""
    if asked["ros2_control"] == NO:
        return []
    if asked["lockstep"] == YES or asked["cell_state"] == NO:
        raise RuntimeError(
            "ros2_control:=true needs lockstep:=false and cell_state:=true: controllers run by the clock"
        )
    file = Path(tempfile.mkdtemp(prefix="isf_ros2_control_")) / "controllers.yaml"
    file.write_text(described["controllers"], encoding="utf-8")
    known = yaml.safe_load(described["controllers"])["/**/controller_manager"]["ros__parameters"]
    names = [name for name, about in known.items() if isinstance(about, dict)]
    common: dict[str, Any] = {"package": "controller_manager", "namespace": asked["namespace"], "output": "screen"}
    return [
        Node(executable="ros2_control_node", parameters=[str(file)], **common),
        Node(executable="spawner", name="spawner", arguments=[*names, "--param-file", str(file)], **common),
    ]


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
    secured = bool(cell_nodes.enclave_arguments(cell_nodes.OPERATOR))
    own = {"ROS_SECURITY_ENCLAVE_OVERRIDE": cell_nodes.enclave(cell_nodes.OPERATOR)} if secured else {}
    return [ExecuteProcess(cmd=command, output="screen", additional_env=own)]
