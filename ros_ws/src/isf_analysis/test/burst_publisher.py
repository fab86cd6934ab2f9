"""A process that publishes known messages at a high rate once the recorder listens; started by test_recorder.py.

Usage: burst_publisher.py COUNT RATE. Two streams of wrenches and two of targets get COUNT messages each; the n-th
message of a stream carries n in its numbers. A latched job, one result, heights of the blank holder, events of the
machine and three scans go out as well.

Discovery is not symmetric: a publisher may know the recorder before the recorder knows the publisher. Greetings are
sent until the recorder's diagnostics say that something came on every topic.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from isf_analysis.bag.topics import cell_types, make_message
from isf_msgs.msg import ContourResult, JobInfo, MachineEvent
from isf_ros import qos
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

SCANS = 3


def main() -> int:
    count, rate = int(sys.argv[1]), float(sys.argv[2])
    rclpy.init()
    node = rclpy.create_node("burst")
    # deep enough to send again what a starved computer dropped on the way: the recorder is on trial here, not DDS
    stream = QoSProfile(depth=count, reliability=qos.STREAM.reliability, durability=qos.STREAM.durability)
    wrenches = [node.create_publisher(WrenchStamped, f"tool_{k}/wrench", stream) for k in (1, 2)]
    targets = [node.create_publisher(PoseStamped, f"tool_{k}/target", stream) for k in (1, 2)]
    job = node.create_publisher(JobInfo, "part/info", qos.LATCHED)
    event = node.create_publisher(ContourResult, "contour/result", qos.EVENT)
    holder = node.create_publisher(PoseStamped, "holder/target", stream)
    machine = node.create_publisher(MachineEvent, "machine/event", qos.EVENT)
    scan = node.create_publisher(PointCloud2, "scan", qos.LATCHED)
    publishers = [*wrenches, *targets, job, event, holder, machine, scan]
    if not greet(node, publishers):
        return 1
    job.publish(JobInfo(job_name="burst", plan_id="p"))
    event.publish(ContourResult(plan_id="p", index=7))
    for number in range(1, SCANS + 1):
        holder.publish(target_bytes(number))
        machine.publish(MachineEvent(kind=number, text="burst"))
        scan.publish(PointCloud2(width=number))
        scan.wait_for_all_acked(Duration(seconds=60))  # as the machine does: of a latched topic only the last is kept
    start = time.monotonic()
    for number in range(count):
        for wrench in wrenches:
            wrench.publish(wrench_bytes(number))
        for target in targets:
            target.publish(target_bytes(number))
        ahead = start + (number + 1) / rate - time.monotonic()
        if ahead > 0:
            time.sleep(ahead)  # the rate of a machine, which the recorder has to keep up with; nothing waits for it
    delivered = all(publisher.wait_for_all_acked(Duration(seconds=60)) for publisher in publishers)
    node.destroy_node()
    rclpy.shutdown()
    return 0 if delivered else 1


def greet(node: Any, publishers: list[Any], timeout: float = 120.0) -> bool:
    """Publish empty messages until the recorder has heard all publishers."""
    heard: dict[str, str] = {}

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            heard.update({item.key: item.value for item in status.values})

    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    names = {publisher.topic_name.lstrip("/") for publisher in publishers}
    deadline = time.monotonic() + timeout
    while heard.get("state") != "active" or names & set(heard["silent"].split(", ")):
        if time.monotonic() > deadline:
            return False
        for publisher in publishers:
            publisher.publish(publisher.msg_type())
        rclpy.spin_once(node, timeout_sec=0.1)
    return True


def wrench_bytes(number: int) -> bytes:
    """The n-th wrench, serialised by rosbags: rclpy leaves the bytes between the fields to chance."""
    kind = "geometry_msgs/msg/WrenchStamped"
    message = make_message(kind)
    message.header.frame_id = "sheet"
    message.header.stamp.nanosec = number
    message.wrench.force.z = 0.5 * number
    message.wrench.torque.x = -1.0 * number
    return bytes(cell_types().serialize_cdr(message, kind))


def target_bytes(number: int) -> bytes:
    """The n-th target."""
    kind = "geometry_msgs/msg/PoseStamped"
    message = make_message(kind)
    message.header.frame_id = "sheet"
    message.header.stamp.nanosec = number
    message.pose.position.y = 1e-6 * number
    return bytes(cell_types().serialize_cdr(message, kind))


if __name__ == "__main__":
    sys.exit(main())
