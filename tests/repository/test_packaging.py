"""What a release asks of every package: bloom makes Debian packages from package.xml and CHANGELOG.rst alone."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

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
    "action_msgs", "ament_cmake", "ament_cmake_lint_cmake", "ament_cmake_xmllint", "ament_flake8", "ament_index_python",
    "ament_lint_auto", "ament_pep257", "ament_xmllint", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs",
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


ORDER = (
    ("name",), ("version",), ("description",), ("maintainer",), ("license",), ("url",), ("author",),
    ("build_depend", "build_export_depend", "buildtool_depend", "buildtool_export_depend", "exec_depend", "depend",
     "doc_depend", "test_depend", "conflict", "replace"),
    ("group_depend",), ("member_of_group",), ("export",),
)  # fmt: skip
"""Elements of a package in the order that package_format3.xsd asks for (REP 149), which ament_xmllint reads."""


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_the_manifest_is_of_the_schema(folder: Path) -> None:
    for path in folder.rglob("*.xml"):
        ElementTree.parse(path)
    root = ElementTree.parse(folder / "package.xml").getroot()
    ranks = [next(k for k, names in enumerate(ORDER) if item.tag in names) for item in root]
    assert ranks == sorted(ranks)
    assert all(ranks.count(k) == 1 for k in range(3))
    assert all(
        re.fullmatch(r"[\w%+.-]+@[\w%.-]+\.[a-zA-Z]{2,}", item.get("email", "")) for item in root.iter("maintainer")
    )


@pytest.mark.parametrize(
    "folder", [path for path in PACKAGES if (path / "setup.py").exists()], ids=lambda path: path.name
)
def test_every_package_is_linted_alike(folder: Path) -> None:
    """A package has its own files, since it is released alone."""
    model = SOURCES / "isf_core"
    lint = (model / "test" / "test_isf_core_lint.py").read_text(encoding="utf-8")
    assert (folder / "test" / f"test_{folder.name}_lint.py").read_text(encoding="utf-8") == lint
    flake8, own = (
        (path / "setup.cfg").read_text(encoding="utf-8").partition("[flake8]")[2] for path in (model, folder)
    )
    assert own == flake8
    package, _ = parsed(folder)
    assert {"ament_flake8", "ament_pep257", "ament_xmllint"} <= {item.name for item in package.test_depends}


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_rosdep_knows_every_dependency(folder: Path) -> None:
    package, _ = parsed(folder)
    groups = (package.buildtool_depends, package.build_depends, package.exec_depends, package.test_depends)
    named = {item.name for group in groups for item in group}
    assert named <= ROSDEP | ROS | {other.name for other in PACKAGES}
