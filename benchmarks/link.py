"""Two computers with a bad link between them: does the part come to its end, or stop safely?

usage: sudo ./isf python benchmarks/link.py [--cases good bad partition] [--loss 0.05] [--jitter 0.02] [--json]

Needs root, for network namespaces. One namespace is the computer at the machine (simulated machine, force control,
executive, recorder, by the clock), the other one an office (planner, springback, and who asks for the part). They have
no shared memory, no loopback and no boot number in common; all that passes between them are Ethernet frames, which
this program carries from one to the other:

good       all of them, at once
bad        each is lost with probability --loss, and delayed by 0 to --jitter seconds, so that they overtake each other
partition  none for 10 s while the second contour is formed; the part is then asked to go on

A row per case: code and message of the part, contours, largest force; after a cut the time until no tool was pressed,
the longest time without a wrench until then, and what was formed after going on.
"""

from __future__ import annotations

import argparse
import fcntl
import heapq
import itertools
import json
import math
import os
import random
import select
import shlex
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from isf_cell.processes import executables
from isf_cell.processes.cell_nodes import CellChoice, CellNode, cell_nodes

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from quick_cone import quick_cone  # noqa: E402

CONFIG = ROOT / "ros_ws" / "src" / "isf_cell" / "config"
CELL, OFFICE = "isf_cell", "isf_office"
ADDRESSES = {CELL: "10.77.0.1/24", OFFICE: "10.77.0.2/24"}
IN_OFFICE = ("planner", "springback")
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
"""Of linux/if_tun.h."""
PARTITION = 10.0
"""s without any frame."""
LOADED = 20.0
"""N on a tool, from which on it is pressed against the sheet; cells have noise."""
CASES = ("good", "bad", "partition")


def ip(*words: str) -> None:
    """A command of iproute2; raises CalledProcessError."""
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


class Link:
    """The wire between both namespaces; a context. ``loss`` is a probability, ``jitter`` in s, ``cut`` lets nothing
    pass. All may change at any time."""

    def __init__(self, seed: int = 1) -> None:
        self.loss, self.jitter, self.cut = 0.0, 0.0, False
        self.carried = self.lost = 0
        self._random = random.Random(seed)
        self._thread = threading.Thread(target=self._carry, name="link", daemon=True)
        self._wake, self._stop = os.pipe()
        self._ends: list[int] = []

    def __enter__(self) -> Link:
        for name, address in ADDRESSES.items():
            ip("netns", "add", name)
            end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TAP | IFF_NO_PI))
            self._ends.append(end)
            ip("link", "set", name, "netns", name)
            for words in (
                ("addr", "add", address, "dev", name),
                ("link", "set", "lo", "up"),
                ("link", "set", name, "up"),
                ("route", "add", "224.0.0.0/4", "dev", name),
            ):
                ip("-n", name, *words)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop, b"x")
        self._thread.join()
        for end in (*self._ends, self._wake, self._stop):
            os.close(end)
        for name in ADDRESSES:
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)

    def _carry(self) -> None:
        first, second = self._ends
        other = {first: second, second: first}
        due: list[tuple[float, int, int, bytes]] = []
        numbers = itertools.count()
        while True:
            wait = max(0.0, due[0][0] - time.monotonic()) if due else None
            ready, _, _ = select.select([first, second, self._wake], [], [], wait)
            if self._wake in ready:
                return
            for end in ready:
                frame = os.read(end, 65_536)
                if self.cut or self._random.random() < self.loss:
                    self.lost += 1
                    continue
                delay = self._random.uniform(0.0, self.jitter)
                heapq.heappush(due, (time.monotonic() + delay, next(numbers), other[end], frame))
            while due and due[0][0] <= time.monotonic():
                _, _, end, frame = heapq.heappop(due)
                os.write(end, frame)
                self.carried += 1


class Computer:
    """Starts processes in a namespace, with memory and an identity of their own."""

    def __init__(self, name: str, folder: Path, domain: int, profile: Path) -> None:
        self.name, self._folder, self._domain, self._profile = name, folder, domain, profile.resolve()
        self.processes: dict[str, subprocess.Popen[str]] = {}
        folder.mkdir(parents=True)
        (folder / "boot_id").write_text(f"{name}\n")
        mounts = (
            "mount -t tmpfs none /dev/shm",
            f"mount --bind {shlex.quote(str(folder / 'boot_id'))} /proc/sys/kernel/random/boot_id",
            "echo ready",
            "exec cat",  # until the pipe to it is closed
        )
        inside = ["ip", "netns", "exec", name, "sh", "-c", " && ".join(mounts)]
        self._holder = subprocess.Popen(inside, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != "ready\n":
            sys.exit(f"no memory of its own for {name}")

    def start(self, name: str, command: list[str], **more: Any) -> subprocess.Popen[str]:
        """A process by that ``name``; its output goes to a file of that name unless ``more`` says otherwise."""
        inside = ["nsenter", "--target", str(self._holder.pid), "--mount", "--net", *command]
        env = os.environ | {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "ROS_DOMAIN_ID": str(self._domain),
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(self._profile),
        }
        with (self._folder / f"{name}.log").open("w") as log:
            more.setdefault("stdout", log)
            process = subprocess.Popen(inside, stderr=log, env=env, start_new_session=True, text=True, **more)
        self.processes[name] = process
        return process

    def start_node(self, node: CellNode) -> None:
        """A node of a cell."""
        command = [str(executables.find(node.package, node.executable)), "--ros-args"]
        for key, value in node.parameters.items():
            command += ["-p", f"{key}:={json.dumps(value) if value != '' else chr(39) * 2}"]
        self.start(node.name, command)

    def stop(self) -> None:
        """End all processes."""
        for number, patience in ((signal.SIGINT, 20.0), (signal.SIGKILL, 5.0)):
            for process in self.processes.values():
                if process.poll() is None:
                    os.killpg(process.pid, number)
            for process in self.processes.values():
                try:
                    process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue
        self._holder.communicate()


def ask(*, resume: bool) -> None:
    """In the office: ask for the part, look at its streams as a viewer does, and print what is heard of it, a JSON
    object a line; the last one is its result."""
    import rclpy
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from isf_msgs.action import FormPart
    from isf_ros import qos
    from rclpy.action import ActionClient

    rclpy.init()
    node = rclpy.create_node("office")
    for tool in (1, 2):
        node.create_subscription(WrenchStamped, f"tool_{tool}/wrench", lambda _: None, qos.STREAM)
        node.create_subscription(PoseStamped, f"tool_{tool}/target", lambda _: None, qos.STREAM)
    client = ActionClient(node, FormPart, "form_part")
    client.wait_for_server()
    goal = FormPart.Goal(support_force=math.nan, resume=resume)
    if not resume:
        job = quick_cone("method: elastic", step="1 mm")
        goal.job_text, goal.base_folder = job.text, str(job.base)

    def tell(message: Any) -> None:
        said = message.feedback
        print(json.dumps({"phase": said.phase, "contour": said.index, "of": said.count}), flush=True)

    sent = client.send_goal_async(goal, feedback_callback=tell)
    rclpy.spin_until_future_complete(node, sent)
    result = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, result)
    found = result.result().result
    told = {name: getattr(found, name) for name in ("code", "message", "contours", "sim_time", "wall_time")}
    print(json.dumps({"result": told}), flush=True)


def follow(asking: subprocess.Popen[str], patience: float, heard: Any = lambda _: None) -> dict[str, Any]:
    """Result of the part that ``asking`` waits for; the reason where none came within ``patience`` s."""
    assert asking.stdout is not None
    guard = threading.Timer(patience, asking.kill)
    guard.start()
    try:
        for line in asking.stdout:
            if not line.startswith("{"):  # the middleware writes its warnings there
                print(line, end="", file=sys.stderr)
                continue
            said = json.loads(line)
            if "result" in said:
                found: dict[str, Any] = said["result"]
                return found
            heard(said)
        return {"code": -1, "message": f"no result within {patience:g} s", "contours": 0}
    finally:
        guard.cancel()
        if asking.poll() is None:
            os.killpg(asking.pid, signal.SIGKILL)


def measured(bag: Path, cut: int | None) -> dict[str, Any]:
    """Of the bag of the cell's computer: largest force; where the link was ``cut`` (ns since 1970), s until the first
    moment at which no tool was loaded, and the longest time without a wrench until then."""
    from isf_analysis.bag.open_bag import open_bag

    with open_bag(bag) as opened:
        heard: list[tuple[int, int, float]] = []
        for tool in (1, 2):
            connections = [item for item in opened.connections if item.topic.endswith(f"tool_{tool}/wrench")]
            for when, message in opened.messages(connections):
                force = message.wrench.force
                heard.append((when, tool, math.hypot(force.x, force.y, force.z)))
    found = {"largest_force_n": round(max((force for *_, force in heard), default=0.0), 1)}
    if cut is not None:
        forces, before = {1: 0.0, 2: 0.0}, cut
        for when, tool, force in sorted(heard):
            forces[tool] = force
            if when >= cut:
                found["longest_silence_s"] = max(found.get("longest_silence_s", 0.0), round((when - before) * 1e-9, 3))
                before = when
                if max(forces.values()) < LOADED:
                    found["released_after_s"] = round((when - cut) * 1e-9, 2)
                    break
    return found


def run(case: str, given: argparse.Namespace) -> dict[str, Any]:
    """One case; see above."""
    with ExitStack() as stack:
        folder = given.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder = folder / case
        link = stack.enter_context(Link())
        computers = {name: Computer(name, folder / name, given.domain, given.profile) for name in (CELL, OFFICE)}
        for computer in computers.values():
            stack.callback(computer.stop)
        choice = CellChoice(lockstep=False, bag=str(folder / "bag"), checkpoint=str(folder / "checkpoint"))
        for node in cell_nodes(choice):
            computers[OFFICE if node.name in IN_OFFICE else CELL].start_node(node)
        if case == "bad":
            link.loss, link.jitter = given.loss, given.jitter
        cut: list[int] = []

        def heard(said: dict[str, Any]) -> None:
            print(f"{case}: {said['phase']}, contour {said['contour']} of {said['of']}", file=sys.stderr)
            if case == "partition" and not cut and said["contour"] >= 2 and said["phase"] == "forming":
                cut.append(time.time_ns())
                link.cut = True
                threading.Timer(PARTITION, lambda: setattr(link, "cut", False)).start()

        asking = [sys.executable, __file__, "--ask"]
        office = computers[OFFICE]
        begun = time.monotonic()
        row = {"case": case, **follow(office.start("ask", asking, stdout=subprocess.PIPE), 400.0, heard)}
        row["seconds"] = round(time.monotonic() - begun, 1)
        if cut:
            more = follow(office.start("ask_again", [*asking, "--resume"], stdout=subprocess.PIPE), 400.0, heard)
            row["resumed"] = more
        row["frames"], row["frames_lost"] = link.carried, link.lost
        for computer in computers.values():
            computer.stop()
        row |= measured(folder / "bag", cut[0] if cut else None)
    return row


def main() -> None:
    """Run the cases and print a row for each; exit code 1 when one has no result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--loss", type=float, default=0.05)
    parser.add_argument("--jitter", type=float, default=0.02, help="s")
    parser.add_argument("--domain", type=int, default=int(os.environ.get("ROS_DOMAIN_ID", "0")))
    parser.add_argument("--profile", type=Path, default=CONFIG / "fastdds_link.xml", help="of Fast DDS")
    parser.add_argument("--keep", type=Path, help="folder for logs and bags")
    parser.add_argument("--ask", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--resume", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.ask:
        ask(resume=given.resume)
        return
    if os.geteuid() != 0:
        sys.exit("network namespaces need root: sudo ./isf python benchmarks/link.py")
    rows = [run(case, given) for case in given.cases]
    print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
