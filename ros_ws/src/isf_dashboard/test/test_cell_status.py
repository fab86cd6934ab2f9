"""What holds in a cell, in the words of the page."""

from __future__ import annotations

from isf_dashboard.cell_status import CellStatus, NodeStatus


def test_a_node_that_says_nothing_more_is_silent_and_offers_no_pause() -> None:
    status = CellStatus(phase="forming")
    values = {"busy": "True", "paused": "False", "pid": "12", **{f"value {k}": str(k) for k in range(9)}}
    status.node(1.0, "executive", NodeStatus(0, "active", "ok", values))
    ready = {"stop": True, "pause": True}
    told = status.told(2.0, ready, {"tool_1/pose": 49.6}, heard=True)
    assert (told["busy"], told["paused"], told["phase"], told["machine"]) == (True, False, "forming", None)
    assert told["ready"] == {"stop": True, "pause": True}
    assert told["rates"] == {"tool_1/pose": 50}
    (node,) = told["nodes"]
    assert not node["silent"]
    assert len(node["values"]) == 6
    assert "pid" not in node["values"]
    later = status.told(6.5, ready, {}, heard=False)
    assert later["nodes"][0]["silent"]
    assert (later["busy"], later["phase"], later["ready"]) == (False, "", {"stop": True, "pause": False})


def test_faults_and_limits_of_a_machine_are_told_and_a_mode_of_a_later_version_is_no_fault() -> None:
    status = CellStatus()
    status.machine(2, [(1402, "target jumps")], tared=False, limits=5)
    told = status.told(0.0, {"stop": False, "pause": False}, {}, heard=True)["machine"]
    assert told == {
        "mode": "protective stop",
        "faults": [{"code": 1402, "text": "target jumps"}],
        "tared": False,
        "limits": ["travel", "force"],
    }
    status.machine(9, [], tared=True, limits=0)
    assert status.told(0.0, {"stop": False, "pause": False}, {}, heard=True)["machine"]["mode"] == "mode 9"


def test_pump_oil_and_encoders_are_told_as_long_as_the_machine_tells_of_them() -> None:
    def supply(time: float, status: CellStatus) -> list[tuple[str, bool]]:
        told = status.told(time, {"stop": False, "pause": False}, {}, heard=True)
        return [(one["text"], one["wrong"]) for one in told["supply"]]

    status = CellStatus()
    assert supply(0.0, status) == []
    status.node(1.0, "machine", NodeStatus(0, "active", "ok", {"tick": "9"}))
    assert supply(1.0, status) == [], "a machine without legs"
    well = {"pump": "on", "supply_bar": "98.2", "oil_deg_c": "31.0", "oil": "ok", "encoders": "ok", "cables": "ok"}
    status.node(2.0, "machine", NodeStatus(0, "active", "ok", well))
    right = ["pump on", "98.2 bar", "oil 31.0 °C", "encoders ok", "sensor cables ok"]
    assert supply(2.0, status) == [(text, False) for text in right]
    ill = {"pump": "off", "supply_bar": "3.0", "oil_deg_c": "61.0", "oil": "warm", "encoders": "L3 out of range"}
    status.node(3.0, "machine", NodeStatus(2, "active", "a fault", ill))
    wrong = {"pump off", "oil warm", "encoders L3 out of range"}
    assert {text for text, is_wrong in supply(3.0, status) if is_wrong} == wrong
    assert supply(9.0, status) == [], "silent"
