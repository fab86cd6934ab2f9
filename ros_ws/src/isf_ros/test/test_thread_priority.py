"""Priority of threads: asked of the system, told when it is refused."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys

import pytest
from isf_ros.thread_priority import Privileges, RealTimeSettings, acquire, release

CAP_SYS_NICE, PR_CAPBSET_DROP, RLIMIT_RTPRIO = 23, 24, 14
SCRIPT = """
import json, os
from isf_ros.thread_priority import RealTimeSettings, acquire, release
before = os.sched_getscheduler(0)
granted = acquire(RealTimeSettings(5))
raised = os.sched_getscheduler(0) == os.SCHED_FIFO
release(granted)
print(json.dumps([granted.fifo, raised, os.sched_getscheduler(0) == before, granted.priority, granted.below,
    granted.reason]))
"""


def forbid() -> None:
    """No real-time priority for this process and what it starts, whoever it belongs to."""
    import resource

    resource.setrlimit(RLIMIT_RTPRIO, (0, 0))
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_SYS_NICE)


def outcome(*, forbidden: bool) -> tuple[bool, bool, bool, int, int, str]:
    """Granted, threads raised, given back, priority, the one below, reason."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        preexec_fn=forbid if forbidden else None,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return tuple(json.loads(run.stdout))


def permitted() -> bool:
    """Whether the system lets a process of this user have SCHED_FIFO."""
    ask = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))"
    return subprocess.run([sys.executable, "-c", ask], capture_output=True, timeout=120, check=False).returncode == 0


def test_what_is_permitted_is_granted_and_given_back() -> None:
    granted, raised, back, priority, below, reason = outcome(forbidden=False)
    expected = permitted()
    assert (granted, raised, back) == (expected, expected, True)
    assert (priority, below) == ((5, 4) if expected else (0, 0))
    assert bool(reason) is not expected


def test_what_is_forbidden_is_reported_and_everything_goes_on() -> None:
    granted, raised, back, priority, below, reason = outcome(forbidden=True)
    assert (granted, raised, back, priority, below) == (False, False, True, 0, 0)
    assert reason.startswith("SCHED_FIFO 5: ")


def test_a_priority_that_does_not_exist_is_refused_on_any_system() -> None:
    granted = acquire(RealTimeSettings(priority=1000))
    release(granted)
    assert not granted.fifo
    assert "SCHED_FIFO 1000" in granted.reason
    assert Privileges().values() == {"real_time_priority": 0, "memory_locked": False}


def test_nothing_asked_changes_nothing() -> None:
    before, interval = os.sched_getscheduler(0), sys.getswitchinterval()
    granted = acquire(RealTimeSettings())
    assert (os.sched_getscheduler(0), sys.getswitchinterval()) == (before, interval)
    assert granted.values() == {"real_time_priority": 0, "memory_locked": False}
    release(granted)


@pytest.mark.parametrize(("priority", "below"), [(1, 0), (2, 1), (60, 59)])
def test_the_priority_below_is_an_ordinary_one_at_last(priority: int, below: int) -> None:
    assert Privileges(RealTimeSettings(priority), fifo=True).below == below
    assert Privileges(RealTimeSettings(priority), fifo=False).below == 0
