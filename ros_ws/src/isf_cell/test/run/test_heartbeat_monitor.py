"""Which nodes count as dead."""

from isf_cell.run.heartbeat_monitor import HeartbeatMonitor


def test_only_expected_nodes_that_were_heard_can_be_dead() -> None:
    now = 0.0
    monitor = HeartbeatMonitor(("machine", "planner"), 3.0, clock=lambda: now)
    monitor.hear("machine", "ok")
    monitor.hear("stranger", "ok")
    now = 2.9
    assert monitor.dead() == []
    now = 3.1
    assert monitor.dead() == ["machine"]
    assert not monitor.heard("planner")
    monitor.hear("machine", "[1401 TARGET_NOT_FINITE] ...")
    assert monitor.dead() == []
    assert monitor.last_words("machine").startswith("[1401")
    now = 9.0
    monitor.not_served()
    assert monitor.dead() == []
    assert not monitor.heard("planner")
    now = 12.1
    assert monitor.dead() == ["machine"]


def test_a_node_that_was_active_and_is_not_has_been_taken_down() -> None:
    monitor = HeartbeatMonitor(("machine", "planner"), 3.0)
    monitor.hear("machine", "ok", "inactive")  # on its way up
    monitor.hear("planner", "ok")
    assert monitor.deactivated() == {}
    monitor.hear("machine", "ok", "active")
    monitor.hear("machine", "ok")  # an answer to a call, which tells no state
    assert monitor.deactivated() == {}
    monitor.hear("machine", "ok", "unconfigured")
    assert monitor.deactivated() == {"machine": "unconfigured"}
    monitor.forget()
    monitor.hear("machine", "ok", "inactive")
    assert monitor.deactivated() == {}


def test_a_process_that_runs_is_slow_and_one_that_ended_is_dead_at_once() -> None:
    now, runs = 0.0, {"here": True, "elsewhere": None}
    monitor = HeartbeatMonitor(("machine", "planner"), 3.0, clock=lambda: now, runs=lambda name: runs[name])
    monitor.hear("machine", "ok", process="here")
    monitor.hear("planner", "ok", process="elsewhere")
    now = 3.1
    assert monitor.dead() == ["planner"]
    now = 19.9
    assert monitor.dead() == ["planner"]
    now = 20.1  # it hangs
    assert monitor.dead() == ["machine", "planner"]
    monitor.hear("machine", "ok", process="here")
    monitor.stream("planner")
    assert monitor.dead() == []
    runs["here"] = False
    assert monitor.dead() == ["machine"]


def test_two_living_processes_of_one_name_are_told_and_a_restart_is_not() -> None:
    runs: dict[str, bool | None] = {"7:1@here": True, "8:2@here": True}
    monitor = HeartbeatMonitor(("machine",), 3.0, runs=lambda name: runs[name])
    monitor.hear("machine", "ok", process="7:1@here")
    assert monitor.twice() == {}
    monitor.hear("machine", "ok", process="8:2@here")
    assert monitor.twice() == {"machine": ["7:1@here", "8:2@here"]}
    runs["7:1@here"] = False  # it has ended: the other was started again
    assert monitor.twice() == {}


def test_two_processes_that_cannot_be_seen_are_told_when_they_are_heard_by_turns() -> None:
    monitor = HeartbeatMonitor(("machine",), 3.0, runs=lambda _: None)
    for process in ("7:1@there", "8:2@there"):
        monitor.hear("machine", "ok", process=process)
        assert monitor.twice() == {}
    monitor.hear("machine", "ok", process="7:1@there")
    assert monitor.twice() == {}  # a last word that came late
    monitor.hear("machine", "ok", process="8:2@there")
    assert monitor.twice() == {"machine": ["7:1@there", "8:2@there"]}
    monitor.forget()
    assert monitor.twice() == {}
