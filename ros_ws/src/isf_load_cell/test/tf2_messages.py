"""tf2_msgs for tests where ROS comes without it: its one message, built in a folder.

Processes that use it are started with :func:`with_tf2`; the test's own process cannot load it afterwards.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

FIX = Path(__file__).resolve().parents[2] / "isf_msgs" / "cmake" / "python_include_paths.cmake"
PACKAGE = """<?xml version="1.0"?>
<package format="3">
  <name>tf2_msgs</name> <version>0.0.0</version> <description>One message of tf2.</description>
  <maintainer email="maintainers@isf-cell.invalid">ISF cell maintainers</maintainer> <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend> <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend> <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
RULES = f"""cmake_minimum_required(VERSION 3.19)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}} msg/TFMessage.msg DEPENDENCIES geometry_msgs)
include({FIX})
ament_package()
"""


def installed() -> bool:
    return importlib.util.find_spec("tf2_msgs") is not None


def build(folder: Path) -> Path:
    """Build the package in ``folder``; returns where it is installed. Quarter of a minute of processor time."""
    source, prefix = folder / "tf2_msgs", folder / "install"
    (source / "msg").mkdir(parents=True)
    (source / "msg" / "TFMessage.msg").write_text("geometry_msgs/TransformStamped[] transforms\n")
    (source / "package.xml").write_text(PACKAGE)
    (source / "CMakeLists.txt").write_text(RULES)
    options = [f"-DCMAKE_INSTALL_PREFIX={prefix}", f"-DPython3_EXECUTABLE={sys.executable}", "-DBUILD_TESTING=OFF"]
    options += ["-GNinja"] if shutil.which("ninja") else []
    target = str(folder / "build")
    for command in (
        ["cmake", "-S", str(source), "-B", target, *options],
        ["cmake", "--build", target, "--target", "install"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return prefix


def with_tf2(prefix: Path | None) -> dict[str, str]:
    """Environment of a process that is to find tf2_msgs in ``prefix``; None: it is installed."""
    if prefix is None:
        return dict(os.environ)
    (packages,) = prefix.glob("l*/python3*/*-packages")
    more = {"PYTHONPATH": packages, "LD_LIBRARY_PATH": prefix / "lib", "AMENT_PREFIX_PATH": prefix}
    return {**os.environ, **{name: f"{path}:{os.environ.get(name, '')}" for name, path in more.items()}}
