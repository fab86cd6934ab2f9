"""A node's process: what ROS does not let take part says why; one that is to end does so at once."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

NODE = """
import sys
from isf_ros import process
sys.exit(process.run(lambda: None))
"""


@pytest.mark.parametrize(
    ("arguments", "environment", "said"),
    [
        ([], {"ROS_DOMAIN_ID": "500"}, "ROS_DOMAIN_ID is 500, domains go up to 232"),
        ([], {"ROS_DOMAIN_ID": "cell"}, "ROS_DOMAIN_ID is not an integral number"),
        (["-p", "rate"], {}, "'-p rate'"),
        (["--no-such-rule"], {}, "--no-such-rule"),
        (
            ["--enclave", "/isf/machine"],
            {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"},
            "security is on, and the keystore (ROS_SECURITY_KEYSTORE is not set)",
        ),
    ],
    ids=["domain too high", "domain no number", "rule", "argument", "no keystore"],
)
def test_what_ros_does_not_take_is_told(arguments: list[str], environment: dict[str, str], said: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", NODE, "--ros-args", *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert "[1512 ROS_NOT_STARTED]" in ended.stderr
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("then", "code"),
    [("ctypes.PyDLL(None).sleep(100)", 6), ("pass", 0)],  # that call keeps the interpreter locked
    ids=["held up", "in time"],
)
def test_a_process_that_leaves_is_not_held_up_without_end(then: str, code: int) -> None:
    program = f"import ctypes, time\nfrom isf_ros import process\nwith process.ended_after(0.2, 6):\n    {then}\n"
    program += "time.sleep(0.5)\n"  # outlasts the 0.2 s: a timer that was left behind would end the process there
    ended = subprocess.run([sys.executable, "-c", program], timeout=60, check=False)
    assert ended.returncode == code


QUIET = """
import os, signal, sys, threading
import rclpy
from isf_ros import process
from rclpy.signals import SignalHandlerOptions

ending = process.Ending()
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
executor = process.make_executor(streams=sys.argv[1] == "streams")
executor.add_node(rclpy.create_node("quiet"))
child = os.fork()
if child == 0:  # what is sent to a child is not told to its parent
    os.kill(os.getpid(), signal.SIGTERM)
    os._exit(0)
os.waitpid(child, 0)
executor.spin_once(timeout_sec=0.0)
assert not ending()
wanted = getattr(signal, sys.argv[2])
sender = threading.Timer(0.2, lambda: os.kill(os.getpid(), wanted))
with ending.waking(executor):
    sender.start()
    while not ending():
        executor.spin_once(timeout_sec=600.0)
print("ended")
"""


@pytest.mark.parametrize("executor", ["streams", "others"])
@pytest.mark.parametrize("signal", ["SIGINT", "SIGTERM"])
def test_a_node_to_which_nothing_comes_ends_at_once(executor: str, signal: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", QUIET, executor, signal], timeout=60, capture_output=True, text=True, check=True
    )
    assert ended.stdout == "ended\n"
