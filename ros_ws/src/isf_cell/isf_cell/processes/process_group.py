"""Node processes of one cell: started together, watched, ended together; none survives its owner's end."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Literal

from isf_cell.processes import executables
from isf_cell.processes.cell_nodes import enclave_arguments

_ERROR = re.compile(r"\[(ERROR|FATAL)\]|^\w*(Error|Exception)\b|^\[\d+ [A-Z_]+\]")
"""Lines of a node's output that say what went wrong."""


@dataclass
class NodeProcess:
    """A running node, its name and the file its output goes to."""

    name: str
    popen: subprocess.Popen[bytes]
    log: Path
    command: tuple[str, ...]
    _stream: IO[bytes]
    outlives: bool = False
    """Told to end when the others have ended: what they say last is for it."""

    @property
    def alive(self) -> bool:
        """True while the process runs."""
        return self.popen.poll() is None

    @property
    def end(self) -> str:
        """How it ended, for people, with the last error that it printed; empty while it runs."""
        code = self.popen.poll()
        if code is None:
            return ""
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        errors = [line for line in self.last_lines(20).splitlines() if _ERROR.search(line)]
        return f"{how}; its last error: {errors[-1].strip()}" if errors else how

    def last_lines(self, count: int = 5) -> str:
        """End of the output, for error messages."""
        try:
            return "\n".join(self.log.read_text(errors="replace").splitlines()[-count:])
        except OSError:
            return ""


class ProcessGroup:
    """Starts nodes in sessions of their own and ends all of them on exit, also after an exception.

    An owner that is killed ends nothing any more: then every node receives SIGINT from the system.
    """

    def __init__(self, log_folder: Path) -> None:
        self.log_folder = log_folder
        self.nodes: list[NodeProcess] = []

    def start(
        self,
        package: str,
        executable: str,
        parameters: Mapping[str, object],
        *,
        name: str = "",
        remap: Sequence[str] = (),
        outlives: bool = False,
    ) -> NodeProcess:
        """Start ``lib/<package>/<executable>`` with ROS parameters; raises IsfError NODE_MISSING.

        ``name`` is that of the node, where it is not that of the executable. With ``outlives`` it is ended after the
        others.
        """
        command = [str(executables.find(package, executable)), "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={parameter_value(value)}"]
        for rule in (*([f"__node:={name}"] if name else []), *remap):
            command += ["-r", rule]
        command += enclave_arguments(name or executable)
        node = self._run(name or executable, command, "wb", outlives)
        self.nodes.append(node)
        return node

    def start_again(self, node: NodeProcess) -> NodeProcess:
        """Start a node of this group that has ended anew, as it was started before; its log goes on."""
        node._stream.close()
        again = self._run(node.name, node.command, "ab", node.outlives)
        self.nodes[self.nodes.index(node)] = again
        return again

    def _run(self, name: str, command: Sequence[str], mode: Literal["wb", "ab"], outlives: bool) -> NodeProcess:
        self.log_folder.mkdir(parents=True, exist_ok=True)
        log = self.log_folder / f"{name}.log"
        stream = log.open(mode)
        popen = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=ends_with_owner(signal.SIGINT),
        )
        return NodeProcess(name, popen, log, tuple(command), stream, outlives)

    def __getitem__(self, name: str) -> NodeProcess:
        return next(node for node in self.nodes if node.name == name)

    def dead(self) -> list[NodeProcess]:
        """Processes that have ended."""
        return [node for node in self.nodes if not node.alive]

    def stop(self, patience: float = 8.0) -> None:
        """End all processes, last started first: SIGINT, after ``patience`` s SIGTERM, then SIGKILL."""
        for outlives in (False, True):
            _end([node for node in reversed(self.nodes) if node.outlives == outlives], patience)
        for node in self.nodes:
            node._stream.close()

    def stop_one(self, node: NodeProcess, patience: float = 8.0) -> None:
        """End one process in the same way; it is no longer of this group."""
        _end([node], patience)
        node._stream.close()
        self.nodes.remove(node)

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def _end(nodes: Sequence[NodeProcess], patience: float) -> None:
    for number, wait in ((signal.SIGINT, patience), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0)):
        waiting = [node for node in nodes if node.alive]
        for node in waiting:
            _signal(node.popen, number)
        for node in waiting:
            try:
                node.popen.wait(wait)
            except subprocess.TimeoutExpired:
                continue


def _signal(popen: subprocess.Popen[bytes], number: signal.Signals) -> None:
    try:
        os.killpg(popen.pid, number)
    except ProcessLookupError:
        return


def parameter_value(value: object) -> str:
    """``value`` of a ROS parameter as the command line of a node takes it, in YAML; texts as they are, paths too."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    return "'" + str(value).replace("'", "''") + "'"


_LIBC = ctypes.CDLL(None, use_errno=True)  # loaded here: between fork and exec as little as possible is done
_PR_SET_PDEATHSIG = 1
"""Of prctl(2): the signal that a process receives when the thread that started it ends, for whatever reason."""


def ends_with_owner(number: signal.Signals, owner: int | None = None) -> Callable[[], None]:
    """For ``preexec_fn`` of subprocess: the process receives ``number`` when its owner is gone, however it ended.

    Start it from a thread that lasts as long as the owner does. ``owner``: its process, where it is not this one.
    """
    owner = os.getpid() if owner is None else owner

    def prepare() -> None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != owner:  # ended before the line above
            os._exit(1)

    return prepare
