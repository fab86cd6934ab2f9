"""What a release asks of every package: bloom makes Debian packages from package.xml and CHANGELOG.rst alone."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import Package, parse_package

SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
PACKAGES = sorted(path.parent for path in SOURCES.glob("*/package.xml"))

ROSDEP = {
    "python3-lxml", "python3-matplotlib", "python3-networkx", "python3-numpy", "python3-pytest", "python3-scipy",
    "python3-shapely", "python3-sklearn", "python3-tornado", "python3-yaml",
}  # fmt: skip
"""Keys of rosdep/python.yaml of ros/rosdistro. What has none (numba, contourpy, ...) comes from requirements/."""
ROS = {
    "action_msgs", "ament_cmake", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs",
    "launch", "launch_ros", "lifecycle_msgs", "nav_msgs", "rcl_interfaces", "rclpy", "ros2launch", "rosgraph_msgs",
    "rosidl_default_generators", "rosidl_default_runtime", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs",
    "trajectory_msgs", "visualization_msgs",
}  # fmt: skip
"""Packages of the distribution Jazzy."""


def parsed(folder: Path) -> tuple[Package, list[str]]:
    warnings: list[str] = []
    return parse_package(str(folder / "package.xml"), warnings=warnings), warnings


@pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")  # of docutils, in catkin_pkg
@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_the_changelog_tells_of_the_version(folder: Path) -> None:
    package, _ = parsed(folder)
    changelog = get_changelog_from_path(str(folder), package.name)
    assert changelog is not None
    assert changelog.package_name == package.name
    newest = next(changelog.foreach_version())
    assert newest[0] == package.version
    assert newest[1] is not None  # a date
    (told,) = (str(item).splitlines() for item in newest[2])
    assert len(told) >= 2
    assert told[-1].startswith("* Contributors: ")


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_the_manifest_is_complete(folder: Path) -> None:
    package, warnings = parsed(folder)
    package.validate()
    assert not warnings
    assert package.package_format == 3
    assert all(person.name and "@" in (person.email or "") for person in package.maintainers)
    assert package.licenses == ["Apache-2.0"]
    assert package.description
    setup = folder / "setup.py"
    if setup.exists():
        calls = [node for node in ast.walk(ast.parse(setup.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        said = {key.arg: key.value for call in calls for key in call.keywords}
        version, licence = said["version"], said["license"]
        assert isinstance(version, ast.Constant)
        assert isinstance(licence, ast.Constant)
        assert (version.value, licence.value) == (package.version, "Apache-2.0")


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_rosdep_knows_every_dependency(folder: Path) -> None:
    package, _ = parsed(folder)
    groups = (package.buildtool_depends, package.build_depends, package.exec_depends, package.test_depends)
    named = {item.name for group in groups for item in group}
    assert named <= ROSDEP | ROS | {other.name for other in PACKAGES}
