"""Set-up on machines that lack something: one paragraph that says what and what to do, and exit code 3.

Every test runs a copy of the scripts in an empty folder, so the checks really find nothing done. The last ones run
the environment file of a finished set-up.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import pytest
from isf_ros.process import HAND_OVER

ROOT = Path(__file__).resolve().parents[2]
REFUSED = 3
BASIC_COMMANDS = """
    awk bash basename cat cmp cp cut date df dirname env expr find flock fold getconf grep head ln ls mkdir mv
    paste readlink rm sed sha256sum sleep sort tail tee touch tr uname wc which xargs
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """Copy of what set-up reads, without anything it makes."""
    folder = tmp_path / "repository"
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    shutil.copytree(ROOT / "requirements", folder / "requirements")
    shutil.copytree(ROOT / "ros_ws" / "src" / "isf_msgs", folder / "ros_ws" / "src" / "isf_msgs")
    for name in ("isf", "test.sh", "demo.sh"):
        shutil.copy2(ROOT / name, folder / name)
    return folder


@pytest.fixture
def commands(tmp_path: Path) -> Path:
    """A folder for PATH with the basic commands only: no Python, no compiler."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in BASIC_COMMANDS.split():
        path = shutil.which(name, path="/usr/bin:/bin")
        if path:
            (folder / name).symlink_to(path)
    return folder


def _script(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def _run(command: list[str], **variables: str) -> subprocess.CompletedProcess[str]:
    """Run with a bare environment; 300 s is a bound against hanging, not a measurement."""
    environment: Mapping[str, str] = {"PATH": "/usr/bin:/bin", "HOME": "/nonexistent", "ISF_ROS": "wheels", **variables}
    return subprocess.run(command, env=dict(environment), capture_output=True, text=True, timeout=300, check=False)


def _set_up(repository: Path, **variables: str) -> str:
    """What set-up says on stderr when it refuses; one paragraph and no shell error."""
    done = _run(["bash", str(repository / "scripts" / "setup.sh")], **variables)
    assert done.returncode == REFUSED, done.stderr
    assert "Set-up stopped: " in done.stderr
    for leak in ("Traceback", "command not found", "unbound variable", ": line "):
        assert leak not in done.stderr
    return " ".join(done.stderr.split())


def _working_compiler() -> str:
    compiler = shutil.which("cc")
    assert compiler is not None, "the set-up that these tests run after needs a C compiler"
    return compiler


def test_no_compiler(repository: Path, commands: Path) -> None:
    said = _set_up(repository, PATH=str(commands))
    assert "no working C/C++ compiler" in said
    assert "apt install build-essential" in said


def test_compiler_that_cannot_compile(repository: Path, tmp_path: Path) -> None:
    broken = _script(tmp_path / "broken-cc", "echo 'stdlib.h: No such file or directory' >&2; exit 1")
    said = _set_up(repository, CC=str(broken))
    assert f"'{broken}' cannot compile" in said


def test_python_that_does_not_exist(repository: Path) -> None:
    _working_compiler()
    assert "/no/such/python (does not run)" in _set_up(repository, ISF_PYTHON="/no/such/python")


@pytest.mark.parametrize(
    ("situation", "reason"),
    [
        ("import sysconfig; sysconfig.get_path = lambda *_: '/nonexistent'", "has no Python.h, package python3."),
        ("import sys; sys.version_info = (3, 9, 2)", "is Python 3.9"),
        ("import sys; sys.version_info = (2, 7, 18)", "is Python 2.7"),
        ("import sys; sys.modules['ensurepip'] = None", "has no venv module, package python3."),
        ("import sys; sys._is_gil_enabled = lambda: False", "is a free-threaded build"),
        ("import os; os._exit(1)", "does not run"),
    ],
)
def test_unusable_python_is_named_with_the_reason(
    repository: Path, tmp_path: Path, situation: str, reason: str
) -> None:
    """The probe runs on a real interpreter that is made to look like one that does not do."""
    _working_compiler()
    (tmp_path / "sitecustomize.py").write_text(situation + "\n", encoding="utf-8")
    said = _set_up(repository, ISF_PYTHON=sys.executable, PYTHONPATH=str(tmp_path))
    assert "no usable Python 3.10-3.14" in said
    assert f"{sys.executable} ({reason}" in said
    assert "python3-dev" in said


def test_disk_is_full(repository: Path) -> None:
    said = _set_up(repository, ISF_SETUP_FREE_MB="120")
    assert "only 120 MB are free" in said
    assert "about 2500 MB" in said


def test_folder_cannot_be_written(repository: Path) -> None:
    # /proc/sys refuses new files even to root, as a read-only file system does.
    (repository / ".isf").symlink_to("/proc/sys")
    assert "the folder is read-only or belongs to someone else" in _set_up(repository)


def test_folder_with_a_space(repository: Path) -> None:
    moved = repository.rename(repository.with_name("my repository"))
    said = _set_up(moved)
    assert "has a space or a colon in its path" in said
    assert not (moved / ".isf").exists()


def test_ros_without_what_builds_a_workspace(repository: Path, tmp_path: Path) -> None:
    """An installed ROS is preferred; what it lacks is named with the apt package."""
    _working_compiler()
    prefix = tmp_path / "jazzy"
    prefix.mkdir()
    (prefix / "setup.bash").write_text("export ROS_DISTRO=jazzy\n", encoding="utf-8")
    said = _set_up(repository, ISF_ROS="", ISF_ROS_PREFIX=str(prefix), ISF_PYTHON=sys.executable)
    assert "python3-colcon-common-extensions ros-jazzy-ros-base" in said
    assert "sudo apt install" in said


def test_package_index_out_of_reach(repository: Path) -> None:
    """Port 9 of this computer: nothing listens, the connection is refused at once."""
    _working_compiler()
    said = _set_up(
        repository,
        PATH=os.environ["PATH"],
        HOME=os.environ.get("HOME", "/"),
        PIP_CONFIG_FILE=os.devnull,
        PIP_INDEX_URL="http://127.0.0.1:9/simple",
        NO_PROXY="*",
    )
    assert "the Python package index cannot be reached" in said
    assert "it goes on where it stopped" in said
    assert not (repository / ".isf" / "packages.stamp").exists()


@pytest.mark.parametrize("command", ["isf", "test.sh", "demo.sh"])
def test_every_root_command_ends_with_the_refusal(repository: Path, command: str) -> None:
    done = _run(["bash", str(repository / command)], ISF_SETUP_FREE_MB="1")
    assert done.returncode == REFUSED
    assert "only 1 MB are free" in done.stderr
    assert done.stdout == ""


# -- a finished set-up --------------------------------------------------------------------------------

FINISHED = ROOT / ".isf" / "env.sh"
# What a finished set-up holds can only be looked at after one; ./test.sh makes one first, bare pytest may not.
needs_set_up = pytest.mark.skipif(not FINISHED.exists(), reason="bare pytest, and scripts/setup.sh has not run yet")


def _in_environment(command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return _run(["bash", "-c", f"set -eu; . '{FINISHED}'; {command}"], **variables)


@needs_set_up
def test_foreign_middleware_is_replaced_with_a_note() -> None:
    done = _in_environment('echo "$RMW_IMPLEMENTATION"', RMW_IMPLEMENTATION="rmw_of_another_robot_cpp")
    assert done.stdout.strip() == "rmw_fastrtps_cpp"
    assert "rmw_of_another_robot_cpp is not installed here" in done.stderr


@needs_set_up
def test_other_python_installations_stay_outside() -> None:
    done = _in_environment("python -c 'import isf_core, rclpy'", PYTHONPATH="/nonexistent", PYTHONHOME="/nonexistent")
    assert done.returncode == 0, done.stderr


@needs_set_up
def test_cell_stays_on_this_computer_unless_set_otherwise() -> None:
    show = 'echo "$ROS_AUTOMATIC_DISCOVERY_RANGE"'
    assert _in_environment(show).stdout.strip() == "SYSTEM_DEFAULT"  # the profile closes it: the next test
    assert _in_environment(show, FASTRTPS_DEFAULT_PROFILES_FILE="/of/another/robot.xml").stdout.strip() == "LOCALHOST"
    assert _in_environment(show, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET").stdout.strip() == "SUBNET"


LISTENS = """
import os, rclpy
rclpy.init()
node = rclpy.create_node("isf_listens")
open_files = (f"/proc/self/fd/{fd}" for fd in os.listdir("/proc/self/fd"))
own = {os.readlink(path) for path in open_files if os.path.exists(path)}
first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
for line in open("/proc/net/udp").read().splitlines()[1:]:
    fields = line.split()
    address, port = fields[1].split(":")
    if f"socket:[{fields[9]}]" in own and first <= int(port, 16) < first + 250:
        print(".".join(str(byte) for byte in reversed(bytes.fromhex(address))))
if "/dev/shm/fastrtps" in open("/proc/self/maps").read():
    print("shared memory")
"""
"""Prints the addresses at which a node hears of others and their messages (ports of RTPS 2.5, 9.6.2.4), and whether it
uses shared memory, whose ports do not outlive a killed process as they should."""


@needs_set_up
def test_a_node_hears_this_computer_alone_unless_set_otherwise(tmp_path: Path) -> None:
    program = tmp_path / "listens.py"
    program.write_text(LISTENS, encoding="utf-8")
    domain = {"ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "99")}
    assert set(_in_environment(f"python {program}", **domain).stdout.splitlines()) == {"127.0.0.1"}
    beyond = _in_environment(f"python {program}", ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", **domain)
    assert "0.0.0.0" in beyond.stdout.splitlines()
    assert "shared memory" not in beyond.stdout.splitlines()


@needs_set_up
def test_messages_are_acknowledged_long_before_a_node_gives_up_waiting_for_it() -> None:
    """By the profiles of Fast DDS, which it reads without complaint; another robot's own profiles are left alone."""
    variable = "FASTRTPS_DEFAULT_PROFILES_FILE"
    show = f'echo "${variable}"'
    file = _in_environment(show).stdout.strip()
    period = ElementTree.parse(file).find(".//{*}publisher//{*}heartbeatPeriod")
    assert period is not None
    seconds, nanoseconds = (int(period.findtext(f"{{*}}{name}", "")) for name in ("sec", "nanosec"))
    assert 0.0 < seconds + 1e-9 * nanoseconds < 0.1 * HAND_OVER
    make_node = "import rclpy; rclpy.init(); rclpy.create_node('isf_profiles')"
    made = _in_environment(f'python -c "{make_node}"', **{variable: file})
    assert (made.returncode, made.stdout + made.stderr) == (0, "")
    assert _in_environment(show, **{variable: "/of/another/robot.xml"}).stdout.strip() == "/of/another/robot.xml"


@needs_set_up
def test_bytecode_is_kept_away_from_the_sources_also_where_none_is_wanted() -> None:
    show = "python -c 'import sys; print(sys.pycache_prefix, sys.dont_write_bytecode)'"
    done = _in_environment(show, PYTHONDONTWRITEBYTECODE="1")
    assert done.stdout.split() == [str(ROOT / ".isf" / "cache" / "python"), "False"]


@needs_set_up
def test_shell_syntax_of_all_scripts() -> None:
    for path in [*ROOT.glob("scripts/**/*.sh"), *(ROOT / name for name in ("isf", "demo.sh", "test.sh", ".ci/run"))]:
        done = subprocess.run(["bash", "-n", str(path)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert os.access(path, os.X_OK) or "scripts/setup" in str(path.parent)
