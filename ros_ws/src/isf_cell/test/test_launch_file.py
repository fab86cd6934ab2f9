"""The launch file against stand-ins of ``launch`` and ``launch_ros``: what its arguments start.

tests/graph/test_launched_cell.py starts the nodes that it names.
"""

from __future__ import annotations

import ast
import math
import re
import shlex
from pathlib import Path
from typing import Any

import launch_standin
import pytest
import yaml
from isf_cell.processes.cell_nodes import CellChoice, cell_nodes
from launch_standin import Made, nodes, perform

CELL = Path(__file__).resolve().parents[1]
SOURCES = CELL.parent
EXAMPLES = SOURCES.parents[1] / "examples" / "jobs"
CONFIG_FILE = CELL / "config" / "cell.yaml"

NODES = {
    "machine": "isf_sim",
    "planner": "isf_planner",
    "springback": "isf_springback",
    "force_ctrl": "isf_force_ctrl",
    "executive": "isf_cell",
    "cell_state_publisher": "isf_description",
}


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Globals of the launch file, executed with the stand-ins."""
    return launch_standin.load(CELL / "launch" / "cell.launch.py", monkeypatch)


def started(launch_file: dict[str, Any], **arguments: str) -> dict[str, Made]:
    return nodes(perform(launch_file, **arguments)[0])


def parameters(node: Made) -> dict[str, Any]:
    return dict(node.keywords["parameters"][-1])


def test_every_node_of_the_cell_is_started_once(launch_file: dict[str, Any]) -> None:
    found = started(launch_file)
    assert {name: node.keywords["package"] for name, node in found.items()} == NODES
    managed = [name for name, node in found.items() if type(node).__name__ == "LifecycleNode"]
    assert managed == ["machine", "planner", "springback", "force_ctrl"]  # the executive brings these up
    assert [parameters(found[name])["lockstep"] for name in ("machine", "force_ctrl", "executive")] == [True] * 3


def test_it_is_the_list_that_isf_form_starts(launch_file: dict[str, Any]) -> None:
    """``isf form`` starts cell_nodes(...) as well; what launch adds is the clock."""
    found = started(launch_file, record="bag")
    for node in cell_nodes(CellChoice(bag="bag", viewers=True)):
        said = found.pop(node.name).keywords
        assert (said["package"], said["executable"]) == (node.package, node.executable)
        assert node.parameters.items() <= said["parameters"][-1].items()
    assert not found


def test_arguments_are_described_and_their_choices_kept(launch_file: dict[str, Any]) -> None:
    entities = launch_file["generate_launch_description"]().args[0]
    declared = [item for item in entities if type(item).__name__ == "DeclareLaunchArgument"]
    assert all(item.keywords["description"] for item in declared)
    with pytest.raises(RuntimeError, match="machine:=maybe"):
        perform(launch_file, machine="maybe")


def test_the_manual_gives_arguments_that_there_are(launch_file: dict[str, Any]) -> None:
    entities = launch_file["generate_launch_description"]().args[0]
    pages = [*(SOURCES.parents[1] / "docs").rglob("*.md"), *SOURCES.glob("*/README.md")]
    lines = {
        line
        for page in pages
        for line in re.findall(r"ros2 launch isf_cell cell\.launch\.py ([^`#\n]+)", page.read_text(encoding="utf-8"))
    }
    assert len(lines) > 8
    for line in lines:
        launch_standin.values(entities, dict(word.split(":=") for word in shlex.split(line)))


def test_a_part_is_kept_by_all_that_have_something_to_keep(launch_file: dict[str, Any], tmp_path: Path) -> None:
    found = started(launch_file, checkpoint=str(tmp_path / "kept"))
    assert parameters(found["executive"])["checkpoint"] == str(tmp_path / "kept")
    for name in ("machine", "springback", "force_ctrl"):
        assert parameters(found[name])["state_folder"] == str(tmp_path / "kept")
    assert not [name for name, node in started(launch_file).items() if "state_folder" in parameters(node)]


def test_under_a_driver_no_machine_is_started_and_time_is_the_clock(launch_file: dict[str, Any]) -> None:
    found = started(launch_file, machine="false", lockstep="false", record="bag", log_level="debug")
    assert set(found) == {*NODES, "recorder"} - {"machine"}
    assert parameters(found["force_ctrl"])["lockstep"] is False
    assert parameters(found["cell_state_publisher"])["use_sim_time"] is False
    assert parameters(found["recorder"]) == {"output": "bag", "autostart": True, "use_sim_time": False}
    assert all(node.keywords["ros_arguments"] == ["--log-level", "debug"] for node in found.values())


def test_who_shows_the_cell_has_its_time_in_lockstep(launch_file: dict[str, Any]) -> None:
    found = started(launch_file, rviz="true")
    times = {name: parameters(node)["use_sim_time"] for name, node in found.items()}
    assert {name for name, simulated in times.items() if simulated} == {"cell_state_publisher", "rviz"}
    assert all(parameters(node)["use_sim_time"] for node in started(launch_file, use_sim_time="true").values())


def test_axes_driven_by_controller_manager(launch_file: dict[str, Any]) -> None:
    asked = {"lockstep": "false", "ros2_control": "true"}
    found = started(launch_file, rig="ren2018", namespace="cell_1", **asked)
    assert set(found) == {*NODES, "ros2_control_node", "spawner"}
    assert parameters(found["machine"])["follow"] == "joints"
    assert parameters(found["force_ctrl"])["output"] == "joint_trajectory"
    assert parameters(found["force_ctrl"])["described_joints"] is True
    assert parameters(found["cell_state_publisher"])["ros2_control"] is True
    file = found["ros2_control_node"].keywords["parameters"][0]
    assert found["spawner"].keywords["arguments"] == [
        "joint_state_broadcaster",
        "tool_1",
        "tool_2",
        "--param-file",
        file,
    ]
    assert {node.keywords["namespace"] for node in found.values()} == {"cell_1"}
    shipped = SOURCES / "isf_description" / "config" / "controllers.yaml"
    assert Path(file).read_text(encoding="utf-8") == shipped.read_text(encoding="utf-8")
    with pytest.raises(RuntimeError, match="needs lockstep:=false"):
        started(launch_file, rig="ren2018", ros2_control="true")
    with pytest.raises(RuntimeError, match="ros2_control:=true needs job:= or rig:="):
        started(launch_file, **asked)


def test_some_nodes_alone(launch_file: dict[str, Any]) -> None:
    assert set(started(launch_file, nodes="force_ctrl planner")) == {"force_ctrl", "planner"}
    with pytest.raises(RuntimeError, match=r"the cell has no controller; it has machine, planner, "):
        started(launch_file, nodes="controller")


def test_nine_voltages_of_a_rig_have_their_load_cell(launch_file: dict[str, Any]) -> None:
    found = started(launch_file, rig="torrao2013")
    assert set(found) == {*NODES, "load_cell_1"}
    cell = found["load_cell_1"]
    assert type(cell).__name__ == "LifecycleNode"
    known = {key: value for key, value in parameters(cell).items() if key != "rig"}
    assert known == {"tool": 1, "with_pose": True, "use_sim_time": False}  # its upper tool can be tilted
    assert ("pose", "tool_1/pose") in cell.keywords["remappings"]
    assert Path(parameters(cell)["rig"]).is_file()
    assert ("raw_cells", "tool_1/raw_cells") in cell.keywords["remappings"]
    assert ("wrench", "tool_1/wrench") in cell.keywords["remappings"]
    assert parameters(found["machine"])["raw_cells"] is True
    assert parameters(found["executive"])["load_cells"] == "1"


def test_cells_of_a_driver_by_their_files(launch_file: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "cell_2.yaml"
    found = started(launch_file, machine="false", lockstep="false", load_cell_file_2=str(file))
    assert parameters(found["load_cell_2"]) == {"tool": 2, "file": str(file), "use_sim_time": False}
    assert parameters(found["executive"])["load_cells"] == "2"
    both = started(launch_file, machine="false", load_cells="1 2", load_cell_file_2=str(file))
    assert {"load_cell_1", "load_cell_2"} <= set(both)


def test_cells_of_several_have_clock_and_frames_of_their_own(launch_file: dict[str, Any]) -> None:
    found = started(launch_file, namespace="cell_1", record="bag", rviz="true")
    for name, node in found.items():
        assert node.keywords["namespace"] == "cell_1"
        remappings = node.keywords["remappings"]
        assert ("/clock", "clock") in remappings
        assert (("/tf", "tf") in remappings) == (name in ("cell_state_publisher", "force_ctrl", "recorder", "rviz"))
    shared = started(launch_file, namespace="cell_1", frame_prefix="cell_1/", rviz="true")
    for name in ("cell_state_publisher", "force_ctrl"):
        assert parameters(shared[name])["frame_prefix"] == "cell_1/"
    assert all(("/tf", "tf") not in node.keywords["remappings"] for node in shared.values())
    assert shared["rviz"].keywords["arguments"][-2:] == ["-f", "cell_1/sheet"]
    layout = shared["rviz"].keywords["arguments"][1]
    assert Path(layout.perform({})).is_file()


def test_robot_state_publisher_makes_the_frames_of_the_job(launch_file: dict[str, Any]) -> None:
    found = started(launch_file, job=str(EXAMPLES / "mini_cone.yaml"), robot_state_publisher="true")
    about = parameters(found["robot_state_publisher"])
    assert about["robot_description"].startswith("<?xml")
    assert 'name="tool_2"' in about["robot_description"]
    assert parameters(found["cell_state_publisher"])["publish_tf"] is False
    with pytest.raises(RuntimeError, match="needs job:= or rig:="):
        started(launch_file, robot_state_publisher="true")
    with pytest.raises(RuntimeError, match=r"(?s)rig:=none cannot be used:.*known: behera2015"):
        started(launch_file, rig="none")


def test_what_keeps_nothing_is_started_anew_if_asked_for(launch_file: dict[str, Any]) -> None:
    """Not what a tool depends on from one tick to the next: machine, load cells, force control, executive."""
    found = started(launch_file, respawn="true", load_cells="1 2", record="bag")
    again = {name for name, node in found.items() if node.keywords["respawn"]}
    assert again == {"planner", "springback", "cell_state_publisher"}
    assert not any(node.keywords["respawn"] for node in started(launch_file).values())
    # in one process, too, where that holds for all in it
    actions, _ = perform(launch_file, respawn="true", together="planner springback")
    (shared,) = [one for one in actions if one.keywords.get("executable") == "together"]
    assert shared.keywords["respawn"]
    with pytest.raises(RuntimeError, match="force_ctrl cannot be started anew in mid-part"):
        perform(launch_file, respawn="true", together="planner force_ctrl")


def test_the_request_of_a_part_has_the_enclave_of_the_commands(
    launch_file: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = tmp_path / "cone.yaml"
    job.write_text("name: cone\n", encoding="utf-8")
    for secured, expected in (("false", {}), ("true", {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/isf/operator"})):
        monkeypatch.setenv("ROS_SECURITY_ENABLE", secured)
        (request,) = launch_file["request_part"]({"job": str(job), "namespace": ""})
        assert request.keywords["additional_env"] == expected


def test_named_config_file_exists_and_is_installed(launch_file: dict[str, Any]) -> None:
    actions, context = perform(launch_file)
    for node in nodes(actions).values():
        assert Path(launch_standin.text(node.keywords["parameters"][0], context)).is_file()
    (profile,) = launch_file["middleware"](context) or [None]
    assert profile is None or Path(profile.args[1].perform(context)).is_file()


def test_without_a_job_nothing_is_requested_and_said_so(launch_file: dict[str, Any]) -> None:
    (said,) = launch_file["request_part"]({"job": "", "namespace": ""})
    assert type(said).__name__ == "LogInfo"
    assert "job:=" in said.keywords["msg"]


def test_a_job_that_is_no_file_is_named_with_what_to_give(launch_file: dict[str, Any]) -> None:
    with pytest.raises(RuntimeError, match=r"job:=none\.yaml is no file .* give the path of a job file"):
        launch_file["request_part"]({"job": "none.yaml", "namespace": ""})


@pytest.mark.parametrize(("reach", "whitelisted"), [(None, True), ("LOCALHOST", True), ("SUBNET", False)])
def test_a_cell_stays_on_its_computer_unless_the_user_says_otherwise(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch, reach: str | None, whitelisted: bool
) -> None:
    profiles, scope = "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"
    for name in (profiles, scope, "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    if reach:
        monkeypatch.setenv(scope, reach)
    wanted = dict(action.args for action in launch_file["middleware"]({"link": "false"}))
    assert ("<address>127.0.0.1<" in Path(wanted.pop(profiles).perform({})).read_text(encoding="utf-8")) == whitelisted
    assert wanted == ({} if reach else {scope: "SYSTEM_DEFAULT"})


def test_a_profile_of_the_users_own_stands(launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "mine.xml")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert launch_file["middleware"]({"link": "false"}) == []
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE")
    (closed,) = launch_file["middleware"]({"link": "false"})
    assert closed.args == ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_another_middleware_is_kept_on_the_computer_too(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    wanted = dict(action.args for action in launch_file["middleware"]({"link": "false"}))
    assert wanted["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


def test_nodes_on_other_computers_are_found_and_sent_small_datagrams(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the environment says: that of the ``isf`` command is for one computer."""
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "mine.xml")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    profile, reach = launch_file["middleware"]({"link": "true"})
    assert profile.args[0] == "FASTRTPS_DEFAULT_PROFILES_FILE"
    text = Path(profile.args[1].perform({})).read_text(encoding="utf-8")
    assert int(re.search(r"<maxMessageSize>(\d+)<", text)[1]) <= 1472  # what Ethernet carries in one piece
    assert reach.args == ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")


@pytest.mark.parametrize(("namespace", "action"), [("", "/form_part"), ("/cell_1", "/cell_1/form_part")])
def test_job_becomes_a_goal_of_the_executive(
    launch_file: dict[str, Any], tmp_path: Path, namespace: str, action: str
) -> None:
    job = tmp_path / "cone.yaml"
    job.write_text("name: cone\n# every character: 'ä', \"%\"\n", encoding="utf-8")
    (request,) = launch_file["request_part"]({"job": str(job), "namespace": namespace})
    command = request.keywords["cmd"]
    goal = yaml.safe_load(command[-1])
    assert command[-3:-1] == [action, "isf_msgs/action/FormPart"]
    assert goal["job_text"] == job.read_text(encoding="utf-8")
    assert Path(goal["base_folder"]) == tmp_path
    # 0 N would mean position control; NaN leaves the set-point to the job (FormPart.action)
    assert math.isnan(goal["support_force"])
    fields = (SOURCES / "isf_msgs" / "action" / "FormPart.action").read_text(encoding="utf-8").split("---")[0]
    assert all(f" {name} " in fields for name in goal)


def test_config_names_only_parameters_that_the_nodes_declare() -> None:
    config = yaml.safe_load(CONFIG_FILE.read_text(encoding="utf-8"))
    for key, content in config.items():
        node = key.removeprefix("/**/")
        declared = _declared_parameters(NODES[node])
        assert set(content) == {"ros__parameters"}
        assert set(content["ros__parameters"]) <= declared, f"{key}: not declared by the node"


def _declared_parameters(package: str) -> set[str]:
    """Fields made by ``isf_ros.parameters.parameter`` in the package's sources."""
    names = set()
    for path in (SOURCES / package / package).glob("*.py"):
        for item in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(item, ast.AnnAssign)
                and isinstance(item.target, ast.Name)
                and isinstance(item.value, ast.Call)
                and ast.unparse(item.value.func).endswith("parameter")
            ):
                names.add(item.target.id)
    return names
