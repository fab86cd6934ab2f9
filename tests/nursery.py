"""Where the processes of tests come from: one that has imported what nodes import, and becomes two for every start.

``python nursery.py FILE_DESCRIPTOR``; started and asked by forked_process.py alone. The process made for a request is a
process of its own, with its own standard streams, session, environment and measurement of coverage, and with its own
middleware: this one starts neither threads nor rclpy. What it saves is only that every start imports the same
libraries anew, which takes a second and more.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from isf_cell.processes import process_group

MODULES = (
    "numpy numba.experimental matplotlib.figure pydantic rich scipy.fft scipy.interpolate scipy.ndimage "
    "scipy.optimize scipy.signal scipy.sparse.csgraph scipy.spatial scipy.stats shapely trimesh typer yaml "
    "isf_analysis.bag.recording isf_core.files.job isf_force_ctrl isf_load_cell.cell_file isf_planner.planning "
    "isf_planner.replanning isf_sim.machine.simulated_machine isf_sim.machine.state isf_sim.warm_up "
    "isf_springback "
    "diagnostic_msgs.msg geometry_msgs.msg isf_msgs.action isf_msgs.msg isf_msgs.srv lifecycle_msgs.msg "
    "lifecycle_msgs.srv nav_msgs.msg rcl_interfaces.msg rcl_interfaces.srv rosgraph_msgs.msg sensor_msgs.msg "
    "std_msgs.msg std_srvs.srv visualization_msgs.msg "
)
"""What nodes and commands import, but rclpy: its libraries start threads, which no fork would have."""

Program = Callable[[], None]


def program_of(arguments: list[str]) -> Program:
    """What ``python ARGUMENTS...`` runs: a module, a text or a file."""
    if arguments[0] == "-m":
        name = arguments[1]
        sys.argv = arguments[1:]
        sys.path[0] = os.getcwd()
        sys.modules.pop(name, None)  # as in a new process, where the program is __main__ alone
        return lambda: runpy.run_module(name, run_name="__main__", alter_sys=True) and None
    if arguments[0] == "-c":
        sys.argv = ["-c", *arguments[2:]]
        sys.path[0] = ""
        return lambda: exec(compile(arguments[1], "<string>", "exec"), {"__name__": "__main__"})
    sys.argv = list(arguments)
    sys.path[0] = os.path.dirname(os.path.abspath(arguments[0]))
    return lambda: runpy.run_path(arguments[0], run_name="__main__") and None


ends_with_owner: Callable[[], None]
"""Makes a process receive SIGINT when this one has ended, as this one does when the test's process has."""


def become(request: dict[str, Any], streams: list[int]) -> Program:
    """Turn this fork into the process asked for."""
    if request["session"]:
        os.setsid()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    if request["ends_with_owner"]:
        ends_with_owner()
    show_command(request["arguments"])
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    signal.signal(signal.SIGINT, signal.default_int_handler)
    measure_anew()
    program = program_of(request["arguments"])
    if request["import_from"]:
        sys.path[1:1] = request["import_from"]
        sys.modules["isf_core.files.job"]._registered.cache_clear()  # looked up while this room was made
    return program


def show_command(arguments: list[str]) -> None:
    """What ps and pgrep show of this process is what it runs; there is room for it in the nursery's command line."""
    text = b"\0".join(part.encode() for part in [sys.executable, *arguments])
    fields = Path("/proc/self/stat").read_text().rsplit(")", 1)[1].split()
    begin, end = int(fields[45]), int(fields[46])  # arg_start and arg_end of proc(5)
    with open("/proc/self/mem", "r+b", buffering=0) as memory:
        memory.seek(begin)
        memory.write(text[: end - begin - 1].ljust(end - begin, b"\0"))


def measure_anew() -> None:
    """The lines of this process are its own, not those of the process that it comes from."""
    if "coverage" not in sys.modules or not os.environ.get("COVERAGE_PROCESS_CONFIG"):
        return
    from coverage import Coverage, process_startup

    before = Coverage.current()
    if before is not None:
        before._auto_save = False
        before.stop()
    process_startup(force=True)


def serve(asked: socket.socket) -> Program | None:
    """Answer requests until the asking side closes; in a fork, what the fork has to do."""
    children: dict[int, int] = {}  # file descriptor of the process to its id
    while True:
        ready, _, _ = select.select([asked, *children], [], [])
        for descriptor in [item for item in ready if item is not asked]:
            process = children.pop(descriptor)
            os.close(descriptor)
            _, status = os.waitpid(process, 0)
            asked.send(json.dumps({"ended": process, "code": os.waitstatus_to_exitcode(status)}).encode())
        if asked not in ready:
            continue
        text, streams, _, _ = socket.recv_fds(asked, 1 << 20, 3)
        if not text:
            return None
        process = os.fork()
        if process == 0:
            asked.close()
            for descriptor in children:
                os.close(descriptor)
            return become(json.loads(text), streams)
        for stream in streams:
            os.close(stream)
        children[os.pidfd_open(process)] = process
        asked.send(json.dumps({"started": process}).encode())


def main(descriptor: int) -> Program | None:
    """Import, then serve."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in MODULES.split():
        importlib.import_module(name)
    for package in ("isf_sim", "isf_planner"):  # loads compiled kernels
        importlib.import_module(f"{package}.warm_up").warm_up()
    assert len(os.listdir("/proc/self/task")) == 1, "threads of a library"
    assert "rclpy" not in sys.modules
    global ends_with_owner
    ends_with_owner = process_group.ends_with_owner(signal.SIGINT)
    gc.freeze()
    asked = socket.socket(fileno=descriptor)
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        return serve(asked)
    return None


if __name__ == "__main__":
    program = main(int(sys.argv[1]))
    if program is not None:
        program()
