"""A stand-in for ``launch`` and ``launch_ros``, which the wheels of ROS 2 do not hold: performs a launch file.

Its classes take only the arguments that those of Jazzy take. Substitutions are performed as launch performs them, and a
node becomes the command line that launch_ros makes of it. Starting a cell by launch itself needs an apt installation.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from isf_cell.processes import executables

NODE_ARGUMENTS = {
    "package", "executable", "name", "namespace", "parameters", "remappings", "arguments", "output", "condition",
    "emulate_tty", "respawn", "respawn_delay", "ros_arguments",
}  # fmt: skip


class Made:
    """What a launch file makes; ``allowed`` are the keywords of the real class."""

    allowed: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()

    def __init__(self, *args: Any, **keywords: Any) -> None:
        unknown = set(keywords) - self.allowed
        missing = self.required - set(keywords)
        assert not unknown, f"{type(self).__name__} has no argument {unknown}"
        assert not missing, f"{type(self).__name__} needs {missing}"
        self.args, self.keywords = args, keywords

    def perform(self, context: Mapping[str, str]) -> str:
        raise TypeError(f"{type(self).__name__} is no substitution")


class LaunchConfiguration(Made):
    def perform(self, context: Mapping[str, str]) -> str:
        return context[self.args[0]]


class FindPackageShare(Made):
    def perform(self, context: Mapping[str, str]) -> str:
        return str(prefix_of(self.args[0]) / "share" / self.args[0])


class FindPackagePrefix(Made):
    def perform(self, context: Mapping[str, str]) -> str:
        return str(prefix_of(self.args[0]))


class PathJoinSubstitution(Made):
    def perform(self, context: Mapping[str, str]) -> str:
        return os.path.join(*(text(part, context) for part in self.args[0]))


def _kind(name: str, allowed: set[str] | None = None, required: set[str] | None = None) -> type[Made]:
    return type(name, (Made,), {"allowed": frozenset(allowed or ()), "required": frozenset(required or ())})


MODULES: dict[str, dict[str, type]] = {
    "launch": {"LaunchDescription": _kind("LaunchDescription"), "LaunchContext": dict},
    "launch.action": {"Action": _kind("Action")},
    "launch.actions": {
        "DeclareLaunchArgument": _kind("DeclareLaunchArgument", {"default_value", "description", "choices"}),
        "ExecuteProcess": _kind("ExecuteProcess", {"cmd", "output", "name", "condition", "additional_env"}, {"cmd"}),
        "LogInfo": _kind("LogInfo", {"msg"}, {"msg"}),
        "OpaqueFunction": _kind("OpaqueFunction", {"function", "args", "kwargs"}, {"function"}),
        "SetEnvironmentVariable": _kind("SetEnvironmentVariable"),
    },
    "launch.substitutions": {
        "LaunchConfiguration": LaunchConfiguration,
        "PathJoinSubstitution": PathJoinSubstitution,
    },
    "launch_ros": {},
    "launch_ros.actions": {
        "Node": _kind("Node", NODE_ARGUMENTS, {"executable"}),
        "LifecycleNode": _kind("LifecycleNode", NODE_ARGUMENTS, {"executable", "name", "namespace"}),
    },
    "launch_ros.substitutions": {"FindPackageShare": FindPackageShare, "FindPackagePrefix": FindPackagePrefix},
}


def prefix_of(package: str) -> Path:
    """Folder that ``package`` is installed to."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        if (Path(prefix) / "share" / package / "package.xml").is_file():
            return Path(prefix)
    raise LookupError(f"the package {package} is not installed")


def text(value: Any, context: Mapping[str, str]) -> str:
    """A substitution performed, or the text itself."""
    return value.perform(context) if isinstance(value, Made) else str(value)


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Globals of a launch file, executed with the stand-ins."""
    for name, content in MODULES.items():
        module = ModuleType(name)
        for key, value in content.items():
            setattr(module, key, value)
        monkeypatch.setitem(__import__("sys").modules, name, module)
    names: dict[str, Any] = {"__file__": str(path)}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), names)
    return names


def values(entities: Sequence[Made], given: Mapping[str, str]) -> dict[str, str]:
    """Value of every declared argument; raises RuntimeError for what launch refuses."""
    context: dict[str, str] = {}
    left = dict(given)
    for item in entities:
        if type(item).__name__ == "DeclareLaunchArgument":
            name, said = item.args[0], item.keywords
            context[name] = left.pop(name, text(said.get("default_value", ""), context))
            if "choices" in said and context[name] not in said["choices"]:
                raise RuntimeError(f"{name}:={context[name]} is none of {said['choices']}")
    if left:
        raise RuntimeError(f"no such launch argument: {', '.join(left)}")
    return context


def perform(names: dict[str, Any], **arguments: str) -> tuple[list[Made], dict[str, str]]:
    """Actions of the launch file as ``ros2 launch FILE NAME:=VALUE ...`` has them, and the values of all arguments."""
    entities = list(names["generate_launch_description"]().args[0])
    context = values(entities, arguments)
    actions: list[Made] = []
    for item in entities:
        if type(item).__name__ == "OpaqueFunction":
            actions += item.keywords["function"](context)
        elif type(item).__name__ != "DeclareLaunchArgument":
            actions.append(item)
    return actions, context


def nodes(actions: Sequence[Made]) -> dict[str, Made]:
    """The nodes among ``actions``, by name, or by the executable that names itself."""
    found = [item for item in actions if type(item).__name__ in ("Node", "LifecycleNode")]
    named = {item.keywords.get("name", item.keywords["executable"]): item for item in found}
    assert len(named) == len(found)
    return named


def command(node: Made, context: Mapping[str, str], folder: Path) -> list[str]:
    """Command line of a node of this workspace; parameters that are given by name go into a file in ``folder``."""
    said = node.keywords
    line = [str(executables.find(said["package"], said["executable"])), *said.get("arguments", []), "--ros-args"]
    line += ["-r", f"__node:={said['name']}"] if "name" in said else []
    if said["namespace"]:
        line += ["-r", f"__ns:=/{said['namespace'].strip('/')}"]
    for number, parameters in enumerate(said["parameters"]):
        path = text(parameters, context)
        if isinstance(parameters, dict):
            path = str(folder / f"{said['name']}_{number}.yaml")
            Path(path).write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}), encoding="utf-8")
        line += ["--params-file", path]
    for own, other in said["remappings"]:
        line += ["-r", f"{own}:={other}"]
    return [*line, *said.get("ros_arguments", [])]
