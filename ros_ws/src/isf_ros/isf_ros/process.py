"""How every node's process runs: start, spin until SIGINT or SIGTERM, end with a meaningful exit code."""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import rclpy
from isf_core.errors import ErrorCode, IsfError
from rclpy.duration import Duration
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from isf_ros.lifecycle import OWN_ARGUMENTS, CellNode

EXIT_OK, EXIT_ERROR = 0, 2

HAND_OVER = 2.0
"""s, longest time for which a node that ends waits for its subscribers: launch ends it by force after 5 s."""

LEAVING = 2.0
"""s, longest time that the middleware may take to take a process out of the graph. Fast DDS 2.14 may wait without end:
where another participant leaves at that moment, DomainParticipant::set_listener waits for its callback until a time
that is out of range, and keeps the lock that the callback needs."""

LARGEST_DOMAIN = 232
"""Of DDS: its ports would be above 65,535 else."""

MAX_FAILURES = 100
"""Failures of the executor one after the other after which its process cannot serve and ends."""


def join_graph(args: list[str] | None = None) -> None:
    """Take part in the graph, with signals left alone (see :class:`Ending`).

    Raises IsfError ROS_NOT_STARTED for arguments, a domain or a security set-up that ROS does not take.
    """
    check_domain()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError, UnknownROSArgsError, ...
        why = str(error).partition(", at /")[0].replace("failed to initialize rcl: error not set", _security())
        what = f"ROS could not be started: {why}"
        raise IsfError(ErrorCode.ROS_NOT_STARTED, what, where="environment", advice=_ENVIRONMENT) from error


def check_domain() -> None:
    """Raise IsfError ROS_NOT_STARTED for a domain for which Fast DDS ends the whole process without an exception."""
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    if domain.isdecimal() and int(domain) > LARGEST_DOMAIN:
        what = f"ROS_DOMAIN_ID is {domain}, domains go up to {LARGEST_DOMAIN}"
        raise IsfError(ErrorCode.ROS_NOT_STARTED, what, where="environment", advice=_ENVIRONMENT)


_ENVIRONMENT = (
    "look at the ROS arguments, and at ROS_DOMAIN_ID, RMW_IMPLEMENTATION and ROS_SECURITY_* in the environment"
)


def _security() -> str:
    """What it is when rcl does not say it."""
    if os.environ.get("ROS_SECURITY_ENABLE") != "true":
        return "rcl does not say why"
    keystore = os.environ.get("ROS_SECURITY_KEYSTORE", "")
    return f"security is on, and the keystore ({keystore or 'ROS_SECURITY_KEYSTORE is not set'}) has no such enclave"


class Ending:
    """Whether this process is to end: SIGINT or SIGTERM has come since this was made, or :meth:`end` was called.

    Executors that wait for messages are woken at once. The signals raise no exception any more: as KeyboardInterrupt
    they may come out of rclpy as any other exception (RuntimeError from a conversion of types). For the main thread,
    before :func:`join_graph`.
    """

    def __init__(self) -> None:
        self._told = False
        self._lock = threading.Lock()
        self._executors: list[Executor] = []
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        # Python calls a handler when the main thread comes back from the executor's wait: the number of the signal is
        # written to the pipe at once
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))  # signals to a child do not end its parent
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: None)
        threading.Thread(target=self._listen, args=(reading,), name="signals", daemon=True).start()

    def __call__(self) -> bool:
        """True when the process is to end."""
        return self._told

    def end(self) -> None:
        """The process is to end."""
        with self._lock:
            self._told = True
            for executor in self._executors:
                executor.create_task(_nothing)  # wake() alone goes on waiting

    @contextmanager
    def waking(self, executor: Executor) -> Iterator[None]:
        """``executor`` waits no longer when the process is to end."""
        with self._lock:
            self._executors.append(executor)
        try:
            yield
        finally:
            with self._lock:
                self._executors.remove(executor)

    def _listen(self, reading: int) -> None:
        while number := os.read(reading, 1):
            if number[0] in (signal.SIGINT, signal.SIGTERM):
                self.end()


def _nothing() -> None:
    """A task that only wakes."""


def spin(node: Node, ending: Ending, *, streams: bool = False) -> None:
    """Serve ``node`` until the process is to end.

    Not by the MultiThreadedExecutor of rclpy 7.1, which loses messages of nodes with subscriptions. ``streams``: see
    :func:`make_executor`.
    """
    executor = make_executor(streams=streams)
    executor.add_node(node)
    failures = 0
    try:
        with ending.waking(executor):
            while not ending() and rclpy.ok():
                try:
                    # spin() without a time limit never returns from the EventsExecutor of rclpy 7.1.6
                    executor.spin_once(timeout_sec=0.1)
                except (ExternalShutdownException, ShutdownException):
                    raise
                except Exception as error:  # not of a callback, these are guarded: of rclpy itself, or a bad message
                    failures += 1
                    if failures >= MAX_FAILURES or not isinstance(node, CellNode):
                        raise
                    node.fault(error, "executor")
                else:
                    failures = 0
    finally:
        executor.remove_node(node)


def make_executor(*, streams: bool) -> Executor:
    """For nodes with ``streams`` at the control rate the EventsExecutor where rclpy has it: it needs half the processor
    time for a message."""
    if streams:
        try:
            from rclpy.experimental.events_executor import EventsExecutor
        except ImportError:
            return SingleThreadedExecutor()
        return EventsExecutor()
    return SingleThreadedExecutor()


@dataclass(frozen=True)
class Wanted:
    """A node that is to run: what makes it, ``streams`` of :func:`spin`, and ROS arguments for it alone."""

    make: Callable[[], CellNode[Any]]
    streams: bool
    arguments: tuple[str, ...] = ()


_wanted: list[Wanted] | None = None


def run(make_node: Callable[[], CellNode[Any]], args: list[str] | None = None, *, streams: bool = False) -> int:
    """Run one node in this process; returns the exit code. ``streams``: see :func:`spin`.

    SIGINT and SIGTERM end the loop between two callbacks, so that a node closes while it can still communicate.
    """
    wanted = Wanted(make_node, streams)
    if _wanted is None:
        return run_together([wanted], args)
    _wanted.append(wanted)
    return EXIT_OK


def wanted_by(main: Callable[[], Any], arguments: Sequence[str] = ()) -> list[Wanted]:
    """The nodes that ``main``, an entry point that ends in :func:`run`, would run; what it does before is done.

    ``arguments``: ROS arguments for them alone, which come before those of the process.
    """
    global _wanted
    _wanted = []
    try:
        main()
    except SystemExit:
        pass
    finally:
        found, _wanted = _wanted, None
    return [replace(one, arguments=tuple(arguments)) for one in found]


def run_together(
    wanted: Sequence[Wanted],
    args: list[str] | None = None,
    *,
    check: Callable[[Sequence[CellNode[Any]]], None] = lambda _: None,
) -> int:
    """Run nodes in this process, each by a thread and an executor of its own but for the first; as :func:`run`.

    ``check`` may raise IsfError of the nodes that were made, before any of them is served.
    """
    _give_memory_back()
    atexit.register(gc.freeze)  # else the interpreter looks through all that was imported before it ends: a second
    ending = Ending()
    failures: list[BaseException] = []
    nodes: list[CellNode[Any]] = []
    threads: list[threading.Thread] = []
    code = EXIT_OK

    def serve(node: CellNode[Any], streams: bool) -> None:
        try:
            spin(node, ending, streams=streams)
        except ExternalShutdownException:
            pass
        except Exception as error:  # raised where it is waited for
            failures.append(error)
            ending.end()

    try:
        join_graph(args)
        for one in wanted:
            OWN_ARGUMENTS.set(one.arguments)
            nodes.append(one.make())
        check(nodes)
        for node, one in zip(nodes[1:], wanted[1:], strict=True):
            threads.append(threading.Thread(target=serve, args=(node, one.streams), name=node.get_name(), daemon=True))
            threads[-1].start()
        serve(nodes[0], wanted[0].streams)
        if failures:
            raise failures[0]
    except IsfError as error:
        print(error, file=sys.stderr)
        code = EXIT_ERROR
    finally:
        for thread in threads:
            thread.join()
        for node in nodes:
            node.tell_end()
            node.close()
        for node in nodes:
            hand_over(node)
        code = code or max((node.exit_code for node in nodes), default=EXIT_OK)
        with ended_after(LEAVING, 1 if failures else code):
            for node in nodes:
                node.destroy_node()
            rclpy.try_shutdown()
    return code


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3

_LARGE = 1 << 20
"""Bytes of a block that is given back to the system as soon as it is free, and of what may lie free at a heap's end."""


def _give_memory_back() -> None:
    """Large blocks go back to the system when they are free, where the C library is glibc.

    By itself it raises its limit of what is large with every such block, up to 32 MB, and each thread has a heap: a
    node that plans now in one thread and now in another keeps what each has ever used, and grows part by part.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):
        for limit in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
            libc.mallopt(limit, _LARGE)


_SIGEV_THREAD = 2


class _Event(ctypes.Structure):
    """``struct sigevent`` of glibc: 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_long),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("rest", ctypes.c_char * 32),
    )


@contextmanager
def ended_after(seconds: float, code: int) -> Iterator[None]:
    """What takes longer than ``seconds`` ends the process with the exit ``code``, also in a call that does not return
    and keeps the interpreter: by a timer of the system (timer_create, SIGEV_THREAD, Linux with glibc)."""
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None, use_errno=True)
    event = _Event(value=code, notify=_SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p))
    timer = ctypes.c_void_p()
    made = libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0
    if made:
        whole = int(seconds)
        wanted = (ctypes.c_long * 4)(0, 0, whole, int(1e9 * (seconds - whole)))  # once, after that time
        libc.timer_settime(timer, 0, ctypes.byref(wanted), None)
    try:
        yield
    finally:
        if made:
            libc.timer_delete(timer)


def hand_over(node: Node) -> None:
    """Wait until reliable subscribers have all that was published: with its writer a message on its way would be lost.

    At most :data:`HAND_OVER` s, since a subscriber may have died without a word; topics of few messages first, for each
    of these counts.
    """
    deadline = time.monotonic() + HAND_OVER
    for publisher in sorted(node.publishers, key=lambda publisher: publisher.qos_profile.depth):
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        if publisher.get_subscription_count():
            publisher.wait_for_all_acked(Duration(seconds=left))
