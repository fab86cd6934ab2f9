"""The launch file against stubs of ``launch`` and ``launch_ros``: what it names must exist in this repository.

The wheels of ROS 2 hold no launch system, so the file is run against recording stand-ins which accept only the
arguments that the real classes of Jazzy have. Starting it for real needs an apt installation.
"""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

CELL = Path(__file__).resolve().parents[1]
SOURCES = CELL.parent
LAUNCH_FILE = CELL / "launch" / "cell.launch.py"
CONFIG_FILE = CELL / "config" / "cell.yaml"

NODES = {
    "machine": "isf_sim",
    "planner": "isf_planner",
    "springback": "isf_springback",
    "force_ctrl": "isf_force_ctrl",
    "executive": "isf_cell",
    "recorder": "isf_analysis",
}
NODE_ARGUMENTS = {
    "package", "executable", "name", "namespace", "parameters", "remappings", "arguments", "output", "condition",
    "emulate_tty", "respawn", "ros_arguments",
}  # fmt: skip


class Recorded:
    """A stand-in that keeps what it was made from; ``allowed`` are the keywords of the real class."""

    allowed: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()

    def __init__(self, *args: Any, **keywords: Any) -> None:
        unknown = set(keywords) - self.allowed
        missing = self.required - set(keywords)
        assert not unknown, f"{type(self).__name__} has no argument {unknown}"
        assert not missing, f"{type(self).__name__} needs {missing}"
        self.args, self.keywords = args, keywords

    def perform(self, context: dict[str, str]) -> str:
        return context[self.args[0]]


def _kind(name: str, allowed: set[str] | None = None, required: set[str] | None = None) -> type[Recorded]:
    return type(name, (Recorded,), {"allowed": frozenset(allowed or ()), "required": frozenset(required or ())})


MODULES: dict[str, dict[str, type]] = {
    "launch": {"LaunchDescription": _kind("LaunchDescription"), "LaunchContext": dict},
    "launch.action": {"Action": _kind("Action")},
    "launch.actions": {
        "DeclareLaunchArgument": _kind("DeclareLaunchArgument", {"default_value", "description", "choices"}),
        "ExecuteProcess": _kind("ExecuteProcess", {"cmd", "output", "name", "condition"}, {"cmd"}),
        "LogInfo": _kind("LogInfo", {"msg"}, {"msg"}),
        "OpaqueFunction": _kind("OpaqueFunction", {"function", "args", "kwargs"}, {"function"}),
        "SetEnvironmentVariable": _kind("SetEnvironmentVariable"),
    },
    "launch.conditions": {"IfCondition": _kind("IfCondition")},
    "launch.substitutions": {
        "LaunchConfiguration": _kind("LaunchConfiguration", {"default"}),
        "NotEqualsSubstitution": _kind("NotEqualsSubstitution"),
        "PathJoinSubstitution": _kind("PathJoinSubstitution"),
    },
    "launch_ros": {},
    "launch_ros.actions": {
        "Node": _kind("Node", NODE_ARGUMENTS, {"executable"}),
        "LifecycleNode": _kind("LifecycleNode", NODE_ARGUMENTS, {"executable", "name", "namespace"}),
    },
    "launch_ros.parameter_descriptions": {"ParameterValue": _kind("ParameterValue", {"value_type"})},
    "launch_ros.substitutions": {"FindPackageShare": _kind("FindPackageShare")},
}


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Globals of the launch file, executed with the stand-ins."""
    for name, content in MODULES.items():
        module = ModuleType(name)
        for key, value in content.items():
            setattr(module, key, value)
        monkeypatch.setitem(sys.modules, name, module)
    names: dict[str, Any] = {"__file__": str(LAUNCH_FILE)}
    exec(compile(LAUNCH_FILE.read_text(encoding="utf-8"), str(LAUNCH_FILE), "exec"), names)
    return names


@pytest.fixture
def entities(launch_file: dict[str, Any]) -> list[Recorded]:
    """What the launch description holds."""
    return list(launch_file["generate_launch_description"]().args[0])


def _nodes(entities: list[Recorded]) -> list[Recorded]:
    return [item for item in entities if type(item).__name__ in ("Node", "LifecycleNode")]


def _inside(value: Any) -> Iterator[Recorded]:
    """Every recorded object within ``value``."""
    if isinstance(value, Recorded):
        yield value
        yield from _inside([*value.args, *value.keywords.values()])
    elif isinstance(value, dict):
        yield from _inside(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _inside(item)


def _console_scripts(package: str) -> set[str]:
    """Executables that the package's setup.py installs."""
    tree = ast.parse((SOURCES / package / "setup.py").read_text(encoding="utf-8"))
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    return {text.split(" = ")[0] for text in texts if " = " in text and ":main" in text}


def test_every_node_of_the_cell_is_started_once(entities: list[Recorded]) -> None:
    started = {node.keywords["name"]: node.keywords["package"] for node in _nodes(entities)}
    assert started == NODES
    assert len(_nodes(entities)) == len(NODES)


def test_named_executables_are_installed_by_their_packages(entities: list[Recorded]) -> None:
    for node in _nodes(entities):
        assert node.keywords["executable"] in _console_scripts(node.keywords["package"])


def test_every_launch_argument_is_declared_described_and_used(entities: list[Recorded]) -> None:
    declared = {item.args[0] for item in entities if type(item).__name__ == "DeclareLaunchArgument"}
    used = {item.args[0] for item in _inside(entities) if type(item).__name__ == "LaunchConfiguration"}
    assert declared == {"job", "namespace", "lockstep", "params_file", "record", "machine"}
    assert used == declared - {"job"}  # request_part reads the job, see below
    assert all(item.keywords["description"] for item in entities if type(item).__name__ == "DeclareLaunchArgument")


def test_named_config_file_exists_and_is_installed(entities: list[Recorded]) -> None:
    joined = [item for item in _inside(entities) if type(item).__name__ == "PathJoinSubstitution"]
    assert joined
    for item in joined:
        share, *parts = item.args[0]
        assert share.args == ("isf_cell",)
        path = CELL / Path(*parts)
        assert path.is_file()
        assert f"config/*{path.suffix}" in (CELL / "setup.py").read_text(encoding="utf-8")


def test_without_a_job_nothing_is_requested_and_said_so(launch_file: dict[str, Any]) -> None:
    (said,) = launch_file["request_part"]({"job": "", "namespace": ""})
    assert type(said).__name__ == "LogInfo"
    assert "job:=" in said.keywords["msg"]


def test_a_job_that_is_no_file_is_named_with_what_to_give(launch_file: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"job:=none\.yaml is no file .* give the path of a job file"):
        launch_file["request_part"]({"job": "none.yaml", "namespace": ""})


def test_fast_dds_asks_often_unless_the_user_has_a_profile(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    (variable,) = launch_file["middleware"]()
    assert variable.args[0] == "FASTRTPS_DEFAULT_PROFILES_FILE"
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "mine.xml")
    assert launch_file["middleware"]() == []


def test_every_cell_has_its_own_clock(entities: list[Recorded]) -> None:
    assert all(node.keywords["remappings"] == [("/clock", "clock")] for node in _nodes(entities))


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
