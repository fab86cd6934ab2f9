"""What the simulated machine tells of its sheet in ``/diagnostics``: the proof that it formed slowly enough."""

from __future__ import annotations

import math
from typing import Any

from isf_analysis.bag.open_bag import OpenBag
from isf_analysis.bag.topics import DIAGNOSTICS, make_message

KINETIC = "kinetic_over_plastic"
"""Key of the largest kinetic energy of the sheet so far over the plastic work in it."""


def health_message(kinetic: float, header: Any) -> Any:
    """The last sign of life of a machine whose sheet has the ratio ``kinetic``."""
    value = make_message("diagnostic_msgs/msg/KeyValue", key=KINETIC, value=repr(kinetic))
    status = make_message("diagnostic_msgs/msg/DiagnosticStatus", name="/machine", hardware_id="isf", values=[value])
    return make_message(DIAGNOSTICS.type, header=header, status=[status])


def kinetic_over_plastic(bag: OpenBag, namespace: str, begun: float, until: float) -> float | None:
    """What machine ``namespace``/machine told last of it from ``begun`` to before ``until`` (ns since 1970); None:
    nothing."""
    machine = f"{namespace}/machine"
    connections = [item for item in bag.connections if item.topic == DIAGNOSTICS.name]
    last: tuple[int, bytes] = (0, b"")
    for block in bag.blocks([item for item in connections if item.msgtype == DIAGNOSTICS.type]):
        for k, time in enumerate(block.times.tolist()):
            data = block.message(k).tobytes()
            # of the thousands of a long part only one is looked into
            if max(last[0], begun) <= time < until and KINETIC.encode() in data and machine.encode() in data:
                last = time, data
    if not last[1]:
        return None
    told = bag.types.deserialize_cdr(last[1], DIAGNOSTICS.type).status
    values = [item.value for status in told if status.name == machine for item in status.values if item.key == KINETIC]
    try:
        found = float(values[-1])
    except (IndexError, ValueError):
        return None
    return found if math.isfinite(found) else None
