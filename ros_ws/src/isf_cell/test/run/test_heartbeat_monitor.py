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
