"""By the clock force control is armed right after a tare, and not after a reset: the state is told before the answer.

Of the simulated machine with its state told seldom, and of the driver's example, which tells it ten times a second.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import forked_process
import pytest
import rclpy
from isf_core.errors import ErrorCode
from isf_msgs.msg import MachineState
from isf_msgs.srv import Arm, Reset, Tare
from isf_ros import qos
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from quick_cone import quick_cone
from waiting import LIMIT, Waiting

pytestmark = [pytest.mark.graph, pytest.mark.clock]

MACHINES = {
    "machine": (("-m", "isf_sim.node"), {"lockstep": False, "pose_decimation": 20}),  # of 100 ticks a second
    "driver": (("-m", "isf_driver_example.driver_node"), {"level": 4, "rate": 100.0}),
}


@pytest.mark.parametrize("name", MACHINES)
def test_a_tare_counts_as_soon_as_it_is_answered(name: str, tmp_path: Path) -> None:
    program, parameters = MACHINES[name]
    job = quick_cone("method: none")
    rclpy.init()
    node = rclpy.create_node("asker")
    waiting = Waiting(node)
    change = "machine/change_state"
    states: list[MachineState] = []
    node.create_subscription(MachineState, "machine/state", states.append, qos.STREAM)
    clients: dict[str, Any] = {
        topic: node.create_client(kind, topic)
        for topic, kind in {
            change: ChangeState,
            "machine/tare": Tare,
            "machine/reset": Reset,
            "force_ctrl/arm": Arm,
        }.items()
    }

    def ask(topic: str, request: Any) -> Any:
        sent = clients[topic].call_async(request)
        assert waiting.until(sent.done)
        return sent.result()

    def untared() -> bool:
        """Refused; until force control has found wrenches and poses for their sake."""
        return bool(ask("force_ctrl/arm", armed).code == ErrorCode.NO_TARE)

    armed = Arm.Request(plan_id="plan", count=1, job_text=job.text, support_force=math.nan)
    fresh = Reset.Request(new_blank=True, job_text=job.text, base_folder=str(job.base))
    try:
        with (
            forked_process.node(*program, **parameters),
            forked_process.node("-m", "isf_force_ctrl.node", autostart=True, lockstep=False),
        ):
            assert clients[change].wait_for_service(LIMIT)
            for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
                assert ask(change, ChangeState.Request(transition=Transition(id=transition))).success
            for client in clients.values():
                assert client.wait_for_service(LIMIT)
            assert ask("machine/reset", fresh).code == 0
            assert waiting.until(lambda: states)
            for _ in range(4):
                assert waiting.until(untared)
                assert ask("machine/tare", Tare.Request()).code == 0
                answer = ask("force_ctrl/arm", armed)
                while answer.code in (ErrorCode.WRENCH_LOST, ErrorCode.POSE_LOST):  # a busy computer held them up
                    answer = ask("force_ctrl/arm", armed)
                assert (answer.code, answer.message) == (0, "")
                assert ask("force_ctrl/arm", Arm.Request()).code == 0  # disarmed
                assert ask("machine/reset", fresh).code == 0
                assert ask("force_ctrl/arm", armed).code != 0
    finally:
        waiting.close()
        node.destroy_node()
        rclpy.try_shutdown()
