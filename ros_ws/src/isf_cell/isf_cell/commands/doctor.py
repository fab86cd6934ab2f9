"""``isf doctor``: what works here, what does not, and what to do about it."""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from isf_core.errors import IsfError
from rich.table import Table

from isf_cell.commands import terminal
from isf_cell.commands.exit_codes import Exit
from isf_cell.processes import executables
from isf_cell.processes.cell_nodes import operator_arguments

EXECUTABLES = (
    ("isf_sim", "machine"),
    ("isf_planner", "planner"),
    ("isf_springback", "springback"),
    ("isf_force_ctrl", "force_ctrl"),
    ("isf_load_cell", "load_cell"),
    ("isf_driver_example", "driver"),
    ("isf_description", "cell_state_publisher"),
    ("isf_cell", "executive"),
    ("isf_cell", "isf"),
    ("isf_cell", "together"),
    ("isf_analysis", "recorder"),
    ("isf_dashboard", "dashboard"),
)
"""Everything that the packages install, by package; a test compares it with their set-up files."""

LOCAL_PROFILE = "fastdds_local.xml"
"""Profile of Fast DDS with which a cell hears its own computer alone."""

LIBRARIES = (
    "numpy",
    "scipy",
    "pydantic",
    "pint",
    "yaml",
    "trimesh",
    "shapely",
    "numba",
    "rosbags",
    "matplotlib",
    "rich",
    "tornado",
)


ANEW = "in the repository: ./scripts/setup.sh --force, which brings what is missing and builds the workspace anew"
"""What to do about an installation that is not whole."""


@dataclass(frozen=True)
class Check:
    """Outcome of one check; ``state`` is ok, warning or failed."""

    name: str
    state: str
    found: str
    advice: str = ""


def examine(*, as_json: bool) -> None:
    """Run all checks and show them; exits with CHECK_FAILED when one failed."""
    of_ros = (_without_ros,) if _alone() else (_ros, _nodes, _middleware)
    checks = [check for group in (_python, *of_ros, _libraries, _machine) for check in group()]
    failed = [check for check in checks if check.state == "failed"]
    if as_json:
        terminal.print_json({"ok": not failed, "checks": [asdict(check) for check in checks]})
    colours = {"ok": "green", "warning": "yellow", "failed": "bold red"}
    table = Table(show_edge=False, pad_edge=False)
    for column in ("check", "", "found"):
        table.add_column(column, overflow="fold")
    for check in checks:
        found = f"{check.found}\n[dim]{check.advice}[/dim]" if check.advice else check.found
        table.add_row(check.name, f"[{colours[check.state]}]{check.state}[/]", found)
    terminal.console.print(table)
    if failed:
        terminal.console.print(f"\n[bold red]{len(failed)} check(s) failed[/bold red]")
        sys.exit(Exit.CHECK_FAILED)
    good = all(check.state == "ok" for check in checks)
    terminal.console.print("\nall good" if good else "\nno check failed; see the warnings")


def _python() -> list[Check]:
    version = platform.python_version()
    good = sys.version_info[:2] >= (3, 10)
    return [Check("Python", "ok" if good else "failed", f"{version} ({sys.executable})", "" if good else "needs 3.10+")]


def _alone() -> bool:
    """True in a Python with the packages alone: what needs no ROS is all that is to work there."""
    around = any(os.environ.get(name) for name in ("ROS_DISTRO", "AMENT_PREFIX_PATH"))
    return not around and _import_error("rclpy") is not None


def _without_ros() -> list[Check]:
    advice = f"needed for form, play and nodes; {ANEW}"
    return [Check("ROS 2", "warning", "none, and no workspace: plan, simulate, report and replay work", advice)]


def _import_error(module: str) -> str | None:
    """Why ``module`` cannot be imported; None: it can."""
    try:
        importlib.import_module(module)
    except ImportError as error:
        return str(error)
    return None


def _ros() -> list[Check]:
    distribution = os.environ.get("ROS_DISTRO", "")
    where = "apt" if Path("/opt/ros", distribution).is_dir() and distribution else "wheels"
    checks = [
        Check("ROS 2", "ok", f"{distribution} ({where})")
        if distribution == "jazzy"
        else Check("ROS 2", "warning" if distribution else "failed", distribution or "none", "made for ROS 2 Jazzy")
    ]
    for module in ("rclpy", "isf_msgs.msg"):
        if error := _import_error(module):
            checks.append(Check(module, "failed", error, ANEW))
        else:
            checks.append(Check(module, "ok", "imports"))
    return checks


def _libraries() -> list[Check]:
    missing, found = [], []
    for name in LIBRARIES:
        try:
            module = importlib.import_module(name)
        except ImportError:
            missing.append(name)
        else:
            found.append(f"{name} {getattr(module, '__version__', '')}".strip())
    checks = [Check("libraries", "ok", ", ".join(found))]
    if missing:
        again = "pip install isf-cell again, with its dependencies" if _alone() else ANEW
        checks.append(Check("libraries", "failed", f"missing: {', '.join(missing)}", again))
    return checks


def _nodes() -> list[Check]:
    faults = []
    for package, node in EXECUTABLES:
        try:
            executables.find(package, node)
        except IsfError as error:
            faults.append(error.what)
    if faults:
        return [Check("nodes", "failed", "; ".join(faults), ANEW)]
    return [Check("nodes", "ok", ", ".join(name for _, name in EXECUTABLES if name != "isf"))]


def _middleware() -> list[Check]:
    implementation = os.environ.get("RMW_IMPLEMENTATION", "default")
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    scope = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    profile = Path(os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE", "")).name
    closed = scope == "LOCALHOST" or (scope == "SYSTEM_DEFAULT" and profile == LOCAL_PROFILE)
    checks = [
        Check(
            "discovery",
            "ok" if closed else "warning",
            f"domain {domain}, range {scope}{f' ({profile})' if profile else ''}, RMW {implementation}",
            "" if closed else "other machines can see and disturb this cell",
        )
    ]
    try:
        started = time.perf_counter()
        received = _round_trip()
        took = time.perf_counter() - started
    except Exception as error:  # whatever the middleware raises is the finding
        checks.append(Check("DDS", "failed", str(error), "check RMW_IMPLEMENTATION and the loopback network"))
    else:
        state = "ok" if received else "failed"
        text = f"message received after {took:.2f} s" if received else "no message within 5 s"
        checks.append(Check("DDS", state, text, "" if received else "check the firewall on the loopback interface"))
    return checks


def _round_trip() -> bool:
    """True when a message from one participant reaches another over the middleware."""
    import rclpy
    from isf_ros import qos
    from isf_ros.process import check_domain
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import String

    check_domain()
    contexts = [Context(), Context()]
    received: list[str] = []
    for context in contexts:
        rclpy.init(args=operator_arguments(), context=context)
    try:
        sender = rclpy.create_node("doctor_sender", context=contexts[0])
        receiver = rclpy.create_node("doctor_receiver", context=contexts[1])
        topic = f"isf_doctor_{os.getpid()}"
        publisher = sender.create_publisher(String, topic, qos.LATCHED)
        receiver.create_subscription(String, topic, lambda message: received.append(message.data), qos.LATCHED)
        publisher.publish(String(data="ping"))
        executor = SingleThreadedExecutor(context=contexts[1])
        executor.add_node(receiver)
        deadline = time.monotonic() + 5.0
        while not received and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()
    finally:
        for context in contexts:
            rclpy.try_shutdown(context=context)
    return received == ["ping"]


def _machine() -> list[Check]:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    cores = os.cpu_count() or 1
    return [
        Check(
            "disk", "ok" if free > 1 else "warning", f"{free:.1f} GB free here", "" if free > 1 else "bags need room"
        ),
        Check("cores", "ok" if cores > 1 else "warning", str(cores), "" if cores > 1 else "real time needs two"),
        _real_time(),
    ]


def _real_time() -> Check:
    limit: Callable[[int], int] = os.sched_get_priority_max
    try:
        before = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except PermissionError:
        return Check(
            "real-time priority",
            "warning",
            "not permitted",
            "for real machines: add 'rtprio 80' for your user in /etc/security/limits.conf",
        )
    return Check("real-time priority", "ok", f"permitted (up to {limit(os.SCHED_FIFO)})")
