"""Whether the executive that has a part formed is still there, by what it tells of itself in ``/diagnostics``."""

from __future__ import annotations

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from isf_ros.absence import ENDED, absence
from isf_ros.lifecycle import ENDS
from isf_ros.process_identity import running
from isf_ros.watchdog import ReceiveWatchdog

EXECUTIVE = "executive"
"""Name of the node that forms parts; it tells ``pid`` and ``busy`` at 2 Hz."""


class ExecutiveWatch:
    """Follows the executive in the namespace of ``node``, once it was heard busy, until :meth:`release`.

    It is gone as :func:`isf_ros.absence.absence` says, when it tells that it ends, and when it has not been busy for
    ``patience`` s of wall time though it or a later one is heard: its part is over, or it was started anew. How long
    the cell works on a contour plays no part.
    """

    def __init__(
        self,
        node: Node,
        patience: float,
        clock: Callable[[], float] = time.monotonic,
        runs: Callable[[str], bool | None] = running,
    ) -> None:
        self._name = node.get_namespace().rstrip("/") + "/" + EXECUTIVE
        self._watchdog = ReceiveWatchdog(patience, clock)
        self._runs = runs
        self._process, self._identity, self._left, self._ended = "", "", False, False

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Callback for ``/diagnostics``."""
        for status in message.status:
            if status.name == self._name:
                values = {item.key: item.value for item in status.values}
                busy = values.get("busy") == "True"
                ends = values.get("state") == ENDS and values.get("pid", "") == self._process
                self._ended = self._ended or ends
                self._heard(values.get("pid", ""), values.get("process", ""), busy=busy)

    def release(self) -> None:
        """Nothing is expected until an executive is heard busy."""
        self._process, self._identity, self._left, self._ended = "", "", False, False
        self._watchdog.clear()

    def not_served(self) -> None:
        """This process stood still or was at work itself: what came meanwhile has not been heard yet."""
        if self._watchdog.fed:
            self._watchdog.feed()

    @property
    def followed(self) -> bool:
        """True when an executive was heard busy since the last :meth:`release`."""
        return self._watchdog.fed

    def gone(self) -> str:
        """What to say of an executive that was followed and is gone; empty: it is there, or there was none."""
        if not self._watchdog.fed:
            return ""
        patience = self._watchdog.timeout
        what = ENDED if self._ended else absence(self._watchdog.age(), patience, self._identity, self._runs)
        if self._left and what != ENDED:
            what = f"has left the part for {patience:g} s" if self._watchdog.expired() else ""
        return f"the executive (process {self._process}) {what}" if what else ""

    def _heard(self, process: str, identity: str, *, busy: bool) -> None:
        if busy and self._process in ("", process):
            self._process, self._identity = process, identity
            self._watchdog.feed()
        self._left = not busy or process != self._process
