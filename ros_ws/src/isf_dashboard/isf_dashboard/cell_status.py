"""What holds in a cell now: its nodes, machine and part, in the words of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

SILENT = 5.0
"""s without a sign of life after which a node is shown as silent; as ``silence_timeout`` of the executive."""

MACHINE_MODES = ("idle", "following", "protective stop", "replay")
"""By the constants of ``isf_msgs/MachineState``."""

LIMITS = {1: "travel", 2: "speed", 4: "force"}
"""Flags of ``isf_msgs/MachineState``."""

SHOWN = 6
"""Values of a node that are shown."""

NOT_SHOWN = ("pid", "process", "output", "silent")


MACHINE = "machine"
"""Node whose values in /diagnostics may tell of pump, oil and encoders; a driver may use the same keys."""

SUPPLY = {
    "pump": ("pump {}", "on"),
    "supply_bar": ("{} bar", ""),
    "oil_deg_c": ("oil {} °C", ""),
    "oil": ("oil {}", "ok"),
    "encoders": ("encoders {}", "ok"),
    "cables": ("sensor cables {}", "ok"),
}
"""Keys, what the page says of them, and the value that is right; none: there is no wrong one."""


@dataclass(frozen=True)
class NodeStatus:
    """Of one node, as in /diagnostics: ``level`` 0 ok, 1 warning, 2 error."""

    level: int
    state: str
    text: str
    values: Mapping[str, str]


@dataclass
class CellStatus:
    """Filled by who hears the cell.

    Attributes
    ----------
    phase : what the executive does, "forming" while it forms
    mode, hand : what the executive permits, and movement by hand, as the page shows them; None: nobody told
    """

    phase: str = ""
    mode: Mapping[str, Any] | None = None
    hand: Mapping[str, Any] | None = None
    _nodes: dict[str, tuple[float, NodeStatus]] = field(default_factory=dict)
    _machine: dict[str, Any] | None = None

    def node(self, time: float, name: str, status: NodeStatus) -> None:
        """A node told of itself at ``time`` s."""
        self._nodes[name] = (time, status)

    def machine(self, mode: int, faults: Sequence[tuple[int, str]], *, tared: bool, limits: int) -> None:
        """The machine told its state."""
        self._machine = {
            "mode": MACHINE_MODES[mode] if 0 <= mode < len(MACHINE_MODES) else f"mode {mode}",
            "faults": [{"code": int(code), "text": text} for code, text in faults],
            "tared": tared,
            "limits": [name for flag, name in LIMITS.items() if limits & flag],
        }

    def told(
        self, time: float, ready: Mapping[str, bool], rates: Mapping[str, float], *, heard: bool
    ) -> dict[str, Any]:
        """For the page: ``ready`` names commands that somebody carries out, ``rates`` are in Hz, ``heard``: the tools
        or the machine gave news lately."""
        nodes = []
        for name, (since, status) in sorted(self._nodes.items()):
            values = {key: value for key, value in status.values.items() if key not in NOT_SHOWN and value}
            nodes.append(
                {
                    "name": name,
                    "level": status.level,
                    "state": status.state,
                    "text": status.text,
                    "silent": time - since > SILENT,
                    "values": dict(list(values.items())[:SHOWN]),
                }
            )
        executive = self._nodes.get("executive")
        alive = executive is not None and time - executive[0] <= SILENT
        says = executive[1].values if executive is not None and alive else {}
        busy, paused = says.get("busy") == "True", says.get("paused") == "True"
        return {
            "recorded": False,
            "heard": heard,
            "phase": self.phase if busy else "",
            "busy": busy,
            "paused": paused,
            "machine": self._machine,
            "nodes": nodes,
            "rates": {name: round(rate) if rate >= 10.0 else round(rate, 1) for name, rate in rates.items()},
            "mode": self.mode if alive else None,
            "hand": self.hand,
            "supply": self._supply(time),
            "ready": {"stop": ready["stop"], "pause": ready["pause"] and busy},
        }

    def _supply(self, time: float) -> list[dict[str, Any]]:
        """Pump, oil and encoders as far as the machine tells of them; nothing of one that is silent."""
        since, machine = self._nodes.get(MACHINE, (0.0, None))
        if machine is None or time - since > SILENT:
            return []
        values = machine.values
        shown = []
        for key, (text, right) in SUPPLY.items():
            if not (value := values.get(key, "")) or (key == "oil" and value == right):
                continue
            shown.append({"text": text.format(value), "wrong": bool(right) and value != right})
        return shown
