"""Processes of tests without the imports of a new interpreter: ``start`` and ``run`` as Popen and run of subprocess.

They are made by nursery.py, one for a run of tests. Where the environment decides what is imported by more than folders
before the others in PYTHONPATH, a new interpreter starts after all; where the start of the program itself is the
subject, a test uses subprocess. ``isf form`` starts its nodes as it does for a user; where a test forms a part by the
node graph itself, the fixture ``forked_nodes`` of conftest.py lets it start their installed commands from here.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, TypeAlias

ROOM = "." * 4000
"""On the command line of the nursery, for those of the processes that it becomes."""

_LIMIT = 300.0
"""s; only to end a run that hangs."""


_ENVIRONMENT = dict(os.environ)
_READ_AT_START = ("PYTHONPATH", "LD_LIBRARY_PATH", "NUMBA_CACHE_DIR")


def _folders_before(environment: Mapping[str, str]) -> list[str] | None:
    """What PYTHONPATH of ``environment`` has before that of the nursery; None: there are other differences."""
    given, own = (env.get("PYTHONPATH", "").split(os.pathsep) for env in (environment, _ENVIRONMENT))
    others_differ = any(environment.get(name) != _ENVIRONMENT.get(name) for name in _READ_AT_START[1:])
    if others_differ or given[-len(own) :] != own:
        return None
    return given[: -len(own)]


class _Nursery:
    """The asking side; threads of a test take turns."""

    def __init__(self) -> None:
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        program = str(Path(__file__).with_name("nursery.py"))
        with other:
            self._process = subprocess.Popen(
                [sys.executable, program, str(other.fileno()), ROOM],
                pass_fds=[other.fileno()],
                start_new_session=True,
                env={**os.environ, **{name: _ENVIRONMENT[name] for name in _READ_AT_START if name in _ENVIRONMENT}},
            )
        self._turn = threading.RLock()
        self._codes: dict[int, int] = {}
        self._started: list[int] = []

    def start(self, request: dict[str, Any], streams: list[int]) -> int:
        with self._turn:
            socket.send_fds(self._socket, [json.dumps(request).encode()], streams)
            end = time.monotonic() + _LIMIT
            while not self._started:
                self.listen(max(0.0, end - time.monotonic()))
                assert time.monotonic() < end, "no process was made"
            return self._started.pop()

    def listen(self, patience: float) -> None:
        """Take one message, when one comes within ``patience`` s."""
        if not select.select([self._socket], [], [], patience)[0]:
            return
        with self._turn:
            if not select.select([self._socket], [], [], 0.0)[0]:
                return  # another thread has taken it
            text = self._socket.recv(1 << 16)
            if not text:
                raise ChildProcessError(f"nursery.py has ended with code {self._process.wait(_LIMIT)}")
            message = json.loads(text)
            if "started" in message:
                self._started.append(message["started"])
                self._codes.pop(message["started"], None)
            else:
                self._codes[message["ended"]] = message["code"]

    def code(self, process: int) -> int | None:
        return self._codes.get(process)

    def close(self) -> None:
        self._socket.close()
        self._process.wait(_LIMIT)


class ForkedProcess:
    """What tests use of subprocess.Popen."""

    def __init__(self, nursery: _Nursery, process: int, arguments: Sequence[str], text: bool) -> None:
        self._nursery, self._text = nursery, text
        self.pid, self.args = process, list(arguments)
        self.stdout: IO[Any] | None = None
        self.stderr: IO[Any] | None = None
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code, None while the process runs; minus the number of the signal that ended it."""
        return self._waited(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Exit code; raises subprocess.TimeoutExpired."""
        code = self._waited(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return code

    def _waited(self, timeout: float | None) -> int | None:
        end = time.monotonic() + (_LIMIT * 10 if timeout is None else timeout)
        while self.returncode is None:
            self.returncode = self._nursery.code(self.pid)
            if self.returncode is not None:
                break
            left = end - time.monotonic()
            self._nursery.listen(max(0.0, min(left, 0.5)))
            if left <= 0.0:
                self.returncode = self._nursery.code(self.pid)
                break
        return self.returncode

    def communicate(self, timeout: float) -> tuple[Any, Any]:
        """What comes on the pipes until the process has ended, then its end is waited for."""
        end = time.monotonic() + timeout
        pipes = [stream for stream in (self.stdout, self.stderr) if stream is not None]
        texts: dict[Any, bytes] = dict.fromkeys(pipes, b"")
        left = list(pipes)
        while left:
            ready, _, _ = select.select(left, [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise subprocess.TimeoutExpired(self.args, timeout)
            for stream in ready:
                part = os.read(stream.fileno(), 1 << 16)
                texts[stream] += part
                if not part:
                    left.remove(stream)
        self.wait(max(0.0, end - time.monotonic()))
        found = (texts.get(stream) for stream in (self.stdout, self.stderr))
        first, second = (b if b is None or not self._text else b.decode() for b in found)
        return first, second

    def send_signal(self, number: int) -> None:
        """A signal; none when the process has ended."""
        if self.poll() is None:
            try:
                os.kill(self.pid, number)
            except ProcessLookupError:
                return

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)


Process: TypeAlias = "ForkedProcess | subprocess.Popen[Any]"

_nursery: _Nursery | None = None


def start(
    command: Sequence[str],
    *,
    stdout: int | IO[Any] | None = None,
    stderr: int | IO[Any] | None = None,
    cwd: str | Path | None = None,
    env: Mapping[str, str] | None = None,
    text: bool = False,
    start_new_session: bool = False,
    ends_with_owner: bool = False,
) -> Process:
    """As subprocess.Popen, for a ``command`` that begins with sys.executable, without a standard input."""
    global _nursery
    assert command[0] == sys.executable
    environment = dict(os.environ if env is None else env)
    before = _folders_before(environment)
    if before is None:
        return subprocess.Popen(
            command, stdout=stdout, stderr=stderr, cwd=cwd, env=env, text=text, start_new_session=start_new_session
        )
    if _nursery is None:
        _nursery = _Nursery()
    nothing = os.open(os.devnull, os.O_RDWR)
    mine: list[IO[Any] | None] = []
    given, theirs = [nothing], [nothing]
    for number, stream in ((1, stdout), (2, stderr)):
        reader = None
        if stream is None:
            given.append(number)
        elif stream == subprocess.PIPE:
            read, write = os.pipe()
            reader = open(read, "r" if text else "rb")  # noqa: SIM115, the caller's
            given.append(write)
            theirs.append(write)
        elif stream == subprocess.STDOUT:
            given.append(given[1])
        elif stream == subprocess.DEVNULL:
            given.append(nothing)
        else:
            given.append(stream if isinstance(stream, int) else stream.fileno())
        mine.append(reader)
    request = {
        "arguments": [str(part) for part in command[1:]],
        "folder": str(cwd or Path.cwd()),
        "environment": environment,
        "import_from": before,
        "session": start_new_session,
        "ends_with_owner": ends_with_owner,
    }
    try:
        process = ForkedProcess(_nursery, _nursery.start(request, given), command, text)
    finally:
        for stream in theirs:
            os.close(stream)
    process.stdout, process.stderr = mine
    return process


def run(
    command: Sequence[str],
    *,
    cwd: str | Path | None = None,
    env: Mapping[str, str] | None = None,
    timeout: float = 600.0,
) -> subprocess.CompletedProcess[str]:
    """As subprocess.run with capture_output and text; the code is not checked."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = start(command, stdout=out, stderr=err, cwd=cwd, env=env)
        try:
            code = process.wait(timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(_LIMIT)
            raise
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read())
    return subprocess.CompletedProcess(list(command), code, *texts)


@contextmanager
def node(
    *command: str, remap: Mapping[str, str] | None = None, env: Mapping[str, str] | None = None, **parameters: object
) -> Iterator[Process]:
    """A node as ``ros2 run`` starts it, ``command`` being Python's arguments, until the end of the block.

    A node that has not ended by itself is interrupted then, as Ctrl-C does, and has to end with code 0.
    """
    arguments = [sys.executable, *command, "--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    for name, new in (remap or {}).items():
        arguments += ["-r", f"{name}:={new}"]
    process = start(arguments, env=env, start_new_session=True)
    try:
        yield process
    finally:
        interrupted = process.poll() is None
        if interrupted:
            os.killpg(process.pid, signal.SIGINT)
        code = process.wait(_LIMIT)
        assert not interrupted or code == 0, f"{command[-1]} ended with code {code}"


def node_of_group(
    command: Sequence[str],
    *,
    stdin: int,
    stdout: IO[Any],
    stderr: int,
    start_new_session: bool,
    preexec_fn: Callable[[], None],
) -> Process:
    """As ProcessGroup calls Popen: the installed command of a node; ``preexec_fn`` ends it with its owner."""
    assert stdin == subprocess.DEVNULL
    assert preexec_fn is not None
    return start(
        [sys.executable, *command],
        stdout=stdout,
        stderr=stderr,
        start_new_session=start_new_session,
        ends_with_owner=True,
    )


def close() -> None:
    """At the end of the run: conftest.py."""
    global _nursery
    if _nursery is not None:
        _nursery.close()
        _nursery = None
