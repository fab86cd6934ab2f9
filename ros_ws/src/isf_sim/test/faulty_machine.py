"""Node machine with a defect: it raises what nobody expects, where the file ``FAULT`` (environment) says.

"once": the next tick ; "twice": that and the first tick of the release after it ; "always": every tick ; "watch": the
look at the executive ; "blank": a new blank.
"""

import os
import sys
from pathlib import Path
from typing import Any

from isf_ros.executive_watch import ExecutiveWatch
from isf_sim import node
from isf_sim.machine.simulated_machine import SimulatedMachine

ADVANCE, GONE = SimulatedMachine._advance, ExecutiveWatch.gone
THEN = {"once": "", "twice": "once"}


def asked() -> str:
    file = Path(os.environ["FAULT"])
    return file.read_text() if file.exists() else ""


def advance(self: SimulatedMachine, *arguments: Any) -> Any:
    word = asked()
    if word in THEN:
        Path(os.environ["FAULT"]).write_text(THEN[word])
    if word in (*THEN, "always"):
        raise IndexError("in a tick")
    return ADVANCE(self, *arguments)


def gone(self: ExecutiveWatch) -> str:
    if asked() == "watch":
        raise LookupError("in the look at the executive")
    return GONE(self)


def blank(*arguments: Any, **options: Any) -> SimulatedMachine:
    if asked() == "blank":
        raise ArithmeticError("in a new blank")
    return SimulatedMachine(*arguments, **options)


if __name__ == "__main__":
    SimulatedMachine._advance, ExecutiveWatch.gone = advance, gone  # type: ignore[method-assign]
    node.SimulatedMachine = blank  # type: ignore[assignment, misc]
    sys.exit(node.main())
