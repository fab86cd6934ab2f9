"""Which executive is followed, and when it is gone, on a clock that the test moves."""

from collections.abc import Iterator

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from isf_ros.executive_watch import ExecutiveWatch
from rclpy.node import Node


@pytest.fixture(scope="module")
def node() -> Iterator[Node]:
    rclpy.init()
    made = Node("watcher", namespace="cell_2")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def reports(process: int, *, busy: bool, name: str = "/cell_2/executive") -> DiagnosticArray:
    values = [KeyValue(key="pid", value=str(process)), KeyValue(key="busy", value=str(busy))]
    return DiagnosticArray(status=[DiagnosticStatus(name=name, values=values)])


def test_only_the_busy_executive_of_the_own_cell_is_followed(node: Node) -> None:
    now = 0.0
    watch = ExecutiveWatch(node, 5.0, clock=lambda: now)
    watch.on_diagnostics(reports(7, busy=False))
    watch.on_diagnostics(reports(8, busy=True, name="/executive"))
    watch.on_diagnostics(reports(9, busy=True, name="/cell_2/machine"))
    now = 100.0
    assert not watch.followed
    assert watch.gone() == ""


@pytest.mark.parametrize(
    ("process", "busy", "words"),
    [(None, False, "has given no sign of life"), (7, False, "has left the part"), (8, True, "has left the part")],
    ids=["silent", "part over", "started anew"],
)
def test_it_is_gone_when_nobody_is_busy_with_the_part(process: int | None, busy: bool, words: str, node: Node) -> None:
    time = [0.0]
    watch = ExecutiveWatch(node, 5.0, clock=lambda: time[0])
    watch.on_diagnostics(reports(7, busy=True))
    for time[0] in (3.0, 6.0):
        watch.on_diagnostics(reports(7, busy=True))
    for time[0] in (8.0, 10.9):
        if process is not None:
            watch.on_diagnostics(reports(process, busy=busy))
        assert watch.gone() == ""
    time[0] = 11.1
    assert f"(process 7) {words}" in watch.gone()
    watch.not_served()
    assert watch.gone() == ""
    watch.release()
    time[0] = 99.0
    assert watch.gone() == ""


def identified() -> DiagnosticArray:
    told = reports(7, busy=True)
    told.status[0].values = [*told.status[0].values, KeyValue(key="process", value="7:1@here")]
    return told


@pytest.mark.parametrize("left", [False, True])
def test_an_executive_whose_process_is_seen_to_have_ended_is_gone_at_once(left: bool, node: Node) -> None:
    runs = [True]
    watch = ExecutiveWatch(node, 5.0, clock=lambda: 0.0, runs=lambda _: runs[0])
    watch.on_diagnostics(identified())
    if left:
        watch.on_diagnostics(reports(8, busy=False))  # the next one is there already
    assert watch.gone() == ""
    runs[0] = False
    assert watch.gone() == "the executive (process 7) has ended"


@pytest.mark.parametrize(("runs", "silence"), [(True, 20.1), (None, 5.1)])
def test_a_silent_executive_whose_process_is_seen_running_is_slow(
    runs: bool | None, silence: float, node: Node
) -> None:
    time = [0.0]
    watch = ExecutiveWatch(node, 5.0, clock=lambda: time[0], runs=lambda _: runs)
    watch.on_diagnostics(identified())
    time[0] = silence - 0.2
    assert watch.gone() == ""
    time[0] = silence
    assert "has given no sign of life" in watch.gone()


def test_an_executive_that_tells_that_it_ends_is_gone_at_once(node: Node) -> None:
    watch = ExecutiveWatch(node, 5.0, clock=lambda: 0.0, runs=lambda _: True)
    watch.on_diagnostics(identified())
    ends = identified()
    ends.status[0].values = [*ends.status[0].values, KeyValue(key="state", value="finalized")]
    watch.on_diagnostics(ends)
    watch.on_diagnostics(reports(8, busy=False))
    assert watch.gone() == "the executive (process 7) has ended"
    watch.release()
    assert watch.gone() == ""
