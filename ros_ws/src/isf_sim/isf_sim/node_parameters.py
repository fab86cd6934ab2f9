"""Parameters of the node ``machine``."""

from __future__ import annotations

from dataclasses import dataclass

from isf_node.parameters import parameter


@dataclass(frozen=True)
class MachineParameters:
    """Parameters of the node ``machine``."""

    lockstep: bool = parameter(True, "one tick per pair of targets; false: ticks by the wall clock")
    job: str = parameter("", "job file whose blank is clamped at the start; empty: by machine/reset")
    world: int = parameter(0, "plant for that blank: 0 nominal, others seeded off-nominal plants")
    seed: int = parameter(0, "seed of noise and of the off-nominal plant")
    target_timeout: float = parameter(
        0.0, "s without targets before contact is released; 0: 5 lockstep, 0.25 real time"
    )
    real_time_priority: int = parameter(
        0, "SCHED_FIFO priority asked for while ticking by the clock; 0: none", least=0, most=98
    )
    pose_decimation: int = parameter(0, "ticks per pose, clock and state message; 0: 50 messages per second")
