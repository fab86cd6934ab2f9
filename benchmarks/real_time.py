"""Node force_ctrl by the wall clock: period, ticks on time and latency, with and without real-time scheduling.

    ./isf python benchmarks/real_time.py                            # all rates, quiet and busy, ordinary and FIFO
    ./isf python benchmarks/real_time.py --rates 500 --seconds 20

The real node runs in a process of its own and forms rings of a cone against a light source of wrenches in another one
(no plant: the wrenches are the set-point, a little noise, and 20 N on the forming tool). *Busy* means one spinning
process per core besides. The source stands for hardware: it has real-time priority in every row, where the system
permits any. "at the driver" is what the source sees: from the moment before it publishes a pair of wrenches to the
arrival of the second target of the pair that follows, both ways through the middleware included. "in the node" is what
the node measures and publishes in ``/diagnostics``: from the newer wrench out of the middleware to both targets handed
to it. A tick is on time when its targets are out before the next one is due.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

DRIVER_PRIORITY = 80
RADIUS, POINTS = 60e-3, 750
JOB = """
name: ring
part: {{mesh: ring.stl, unit: mm}}
process: DSIF
rig: ren2018
sheet: {{material: AA5754-O, thickness: 1 mm}}
tool_1: {{radius: 5 mm}}
tool_2: {{radius: 5 mm}}
path: {{incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}}
control: {{rate: {rate} Hz, support_force: 120 N, compliance_compensation: 0.5}}
"""


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    rate: float
    busy: bool
    fifo: bool
    seconds: float
    settle: float
    """s of forming before the source begins to measure."""


# -- source of wrenches, in a process of its own -------------------------------------------------


def drive(rate: float, seconds: float, settle: float) -> None:
    """Publish wrenches at ``rate`` Hz and time the targets, for ``seconds`` s after ``settle`` s; prints JSON."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from isf_msgs.msg import ForceCtrlState, MachineState
    from isf_ros import conversion, qos, stamps
    from isf_ros.thread_priority import RealTimeSettings, acquire
    from rclpy.clock import Clock, ClockType
    from rclpy.experimental.events_executor import EventsExecutor

    rclpy.init()
    node = rclpy.create_node("machine")
    publishers = [node.create_publisher(WrenchStamped, f"tool_{k}/wrench", qos.STREAM) for k in (1, 2)]
    machine = node.create_publisher(MachineState, "machine/state", qos.STREAM)
    poses = [node.create_publisher(PoseStamped, f"tool_{k}/pose", qos.SENSOR) for k in (1, 2)]
    messages = (conversion.make_wrench(), conversion.make_wrench())
    noise = np.random.default_rng(0).normal(0.0, 1.2, (1000, 6)).tolist()
    tips = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    sent: list[float] = []
    arrived: list[float] = []
    state = {"count": 0, "engaged": math.inf}

    def publish() -> None:
        count = state["count"] = state["count"] + 1
        row = noise[int(count) % len(noise)]
        (x1, y1, _), (x2, y2, _) = tips
        distance = math.hypot(x2 - x1, y2 - y1)
        nx, ny = ((x2 - x1) / distance, (y2 - y1) / distance) if distance > 1e-4 else (0.0, 0.0)
        stamp = stamps.to_stamp(time.time_ns())
        before = time.monotonic()
        for message, sign, k in zip(messages, (-120.0, 120.0), (0, 3), strict=True):
            message.header.stamp = stamp
            force = message.wrench.force
            force.x, force.y, force.z = sign * nx + row[k], sign * ny + row[k + 1], 20.0 + row[k + 2]
        sent.append(before)
        for publisher, message in zip(publishers, messages, strict=True):
            publisher.publish(message)
        if count % max(1, rate // 10) == 0:
            machine.publish(MachineState(tared=True))
            for publisher, tip in zip(poses, tips, strict=True):
                pose = conversion.make_pose()
                pose.header.stamp = stamp
                conversion.set_tip(pose, tip)
                publisher.publish(pose)

    def on_target(tool: int, message: PoseStamped) -> None:
        position = message.pose.position
        tips[tool] = (position.x, position.y, position.z)
        if tool == 1:
            arrived.append(time.monotonic())

    def on_state(message: ForceCtrlState) -> None:
        if message.mode == ForceCtrlState.CONTROL and state["engaged"] == math.inf:
            state["engaged"] = time.monotonic()

    node.create_subscription(PoseStamped, "tool_1/target", lambda m: on_target(0, m), qos.STREAM)
    node.create_subscription(PoseStamped, "tool_2/target", lambda m: on_target(1, m), qos.STREAM)
    node.create_subscription(ForceCtrlState, "force_ctrl/state", on_state, qos.STREAM)
    node.create_timer(1.0 / rate, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor = EventsExecutor()
    executor.add_node(node)
    acquire(RealTimeSettings(DRIVER_PRIORITY, True))
    deadline = time.monotonic() + settle + seconds + 60.0
    while time.monotonic() < min(state["engaged"] + settle + seconds, deadline):
        executor.spin_once(timeout_sec=0.1)
    begin = state["engaged"] + settle
    out, back = np.array(sent), np.array(arrived)
    back = back[back > begin]
    answered = np.searchsorted(out, back) - 1
    period = np.diff(back)
    round_trip = back - out[answered]
    print(
        json.dumps(
            {
                "targets": len(back),
                "seconds": float(back[-1] - back[0]) if len(back) > 1 else 0.0,
                "period_ms": _ms(period),
                "round_trip_ms": _ms(round_trip),
                "source_period_ms": _ms(np.diff(out[out > begin])),
            }
        ),
        flush=True,
    )


def _ms(values: np.ndarray) -> list[float]:
    """Median, 99 % and largest in ms."""
    if not len(values):
        return [math.nan] * 3
    return [1e3 * float(v) for v in (*np.percentile(values, [50, 99]), values.max())]


# -- the run -------------------------------------------------------------------------------------


@contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """A child process, ended with SIGINT."""
    child = subprocess.Popen([sys.executable, *command], start_new_session=True, stdout=subprocess.PIPE)
    try:
        yield child
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGINT)
        try:
            child.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait(10)


class Observer:
    """Arms the node, sends contours one after the other, and keeps the node's diagnostics."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from isf_msgs.msg import Contour, ContourResult
        from isf_msgs.srv import Arm
        from isf_ros import qos

        self._rclpy = rclpy
        rclpy.init()
        self.node = rclpy.create_node("observer")
        self.values: dict[str, str] = {}
        self.results: list[Any] = []
        self._arm_type = Arm
        self._arm = self.node.create_client(Arm, "force_ctrl/arm")
        self._contours = self.node.create_publisher(Contour, "contour/corrected", qos.LATCHED)
        self.node.create_subscription(ContourResult, "contour/result", self.results.append, qos.EVENT)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.name.endswith("force_ctrl"):
                self.values = {item.key: item.value for item in status.values}

    def close(self) -> None:
        """End."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()

    def arm(self, rate: float, count: int) -> None:
        """Until the node has seen the source and armed."""
        request = self._arm_type.Request(plan_id="ring", count=count, job_text=JOB.format(rate=rate))
        request.support_force = math.nan
        deadline = time.monotonic() + 90.0
        text = "the node does not answer"
        while time.monotonic() < deadline:
            future = self._arm.call_async(request)  # an answer can be lost while the two have just met
            self._rclpy.spin_until_future_complete(self.node, future, timeout_sec=3.0)
            if future.done():
                response = future.result()
                if response.code == 0:
                    return
                text = response.message
                self._rclpy.spin_once(self.node, timeout_sec=0.1)
        raise SystemExit(f"not armed: {text}")

    def form_until(self, source: subprocess.Popen[bytes], count: int) -> None:
        """Send a ring whenever the one before is done, until the source has measured enough."""
        from force_ctrl_tick import ring
        from isf_ros import conversion

        for index in range(count):
            contour = ring(POINTS, RADIUS, plan_id="ring", index=index, count=count)
            self._contours.publish(conversion.contour_to_message(contour))
            seen = len(self.results)
            while len(self.results) == seen:
                self._rclpy.spin_once(self.node, timeout_sec=0.2)
                if source.poll() is not None:
                    return
            if self.results[-1].code:
                try:
                    source.wait(2.0)  # its wrenches may have ended because it was done
                except subprocess.TimeoutExpired:
                    raise SystemExit(f"contour {index}: {self.results[-1].message}") from None
                return


def measure(case: Case) -> dict[str, Any]:
    """What source and node measured in one run."""
    with ExitStack() as stack:
        if case.busy:
            for _ in range(os.cpu_count() or 1):
                stack.enter_context(process("-c", "while True: pass"))
        numbers = ["--rates", str(case.rate), "--seconds", str(case.seconds), "--settle", str(case.settle)]
        source = stack.enter_context(process(__file__, "--drive", *numbers))
        options = {"autostart": "true", "lockstep": "false"}
        options |= {"real_time_priority": "60" if case.fifo else "0", "lock_memory": str(case.fifo).lower()}
        options |= {"drift_limit": "1e4", "drift_stop": "1e4"}  # the source presses in the air, too
        words = [word for name, value in options.items() for word in ("-p", f"{name}:={value}")]
        stack.enter_context(process("-m", "isf_force_ctrl.node", "--ros-args", *words))
        observer = Observer()
        stack.callback(observer.close)
        count = 2 + int((case.seconds + case.settle) / 10.0)
        observer.arm(case.rate, count)
        observer.form_until(source, count)
        output = source.communicate(timeout=30)[0]
        return {**json.loads(output.splitlines()[-1]), "node": observer.values}


def row(case: Case, found: dict[str, Any]) -> str:
    """Line of the table."""
    node = found["node"]
    ticks, late = int(node.get("real_time_ticks", 0)), int(node.get("late_ticks", 0))
    share = 100.0 * (1.0 - late / ticks) if ticks else math.nan
    scheduling = "FIFO" if node.get("real_time_priority", "0") not in ("0", "False") else "ordinary"
    period = " / ".join(f"{value:.2f}" for value in found["period_ms"])
    trip = " / ".join(f"{value:.2f}" for value in found["round_trip_ms"])
    inside = " / ".join(node.get(f"latency_{key}_ms", "nan") for key in ("p50", "p99", "max"))
    return (
        f"| {case.rate:g} | {'busy' if case.busy else 'quiet'} | {scheduling} | {period} | {share:.2f} "
        f"| {inside} | {trip} | {os.getloadavg()[0]:.1f} |"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rates", type=float, nargs="+", default=[250.0, 440.0, 500.0, 1000.0])
    parser.add_argument("--seconds", type=float, default=10.0, help="measured time of each row")
    parser.add_argument("--settle", type=float, default=3.0, help="s of forming before that")
    parser.add_argument("--load", choices=["quiet", "busy", "both"], default="both")
    parser.add_argument("--scheduling", choices=["ordinary", "fifo", "both"], default="both")
    parser.add_argument("--verbose", action="store_true", help="everything that was measured, as JSON")
    parser.add_argument("--drive", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.drive:
        drive(arguments.rates[0], arguments.seconds, arguments.settle)
        return
    sys.path.insert(0, str(Path(__file__).parent))
    print(
        "| rate [Hz] | cores | scheduling | period p50 / p99 / max [ms] | on time [%] "
        "| latency in the node p50 / p99 / max [ms] | at the driver p50 / p99 / max [ms] | load average |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    for busy in (False, True):
        for fifo in (False, True):
            if arguments.load not in ("both", "busy" if busy else "quiet"):
                continue
            if arguments.scheduling not in ("both", "fifo" if fifo else "ordinary"):
                continue
            for rate in arguments.rates:
                case = Case(rate, busy, fifo, arguments.seconds, arguments.settle)
                found = measure(case)
                print(row(case, found), flush=True)
                if arguments.verbose:
                    print(json.dumps(found, indent=1), flush=True)


if __name__ == "__main__":
    main()
