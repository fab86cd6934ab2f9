"""Whoever waits for the result of an action is told when the node that serves it is gone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from isf_cell.run import identify_client, served
from isf_cell.run.hand_client import HandClient
from isf_cell.run.served import Served
from isf_core.errors import ErrorCode, IsfError
from isf_identify.settings import IdentifySettings


class _Future:
    """Done with ``value``, or never."""

    def __init__(self, value: Any = None, *, done: bool = True) -> None:
        self._value, self._done = value, done

    def done(self) -> bool:
        return self._done

    def result(self) -> Any:
        return self._value


class _Action:
    """Of a node that takes the goal and is killed then."""

    def __init__(self, *_: object) -> None:
        self.there = True

    def server_is_ready(self) -> bool:
        return self.there

    def send_goal_async(self, *_: object, **__: object) -> _Future:
        self.there = False
        return _Future(SimpleNamespace(accepted=True, get_result_async=lambda: _Future(done=False)))

    def destroy(self) -> None:
        pass


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "GONE", 0.1)


def test_a_server_that_comes_back_in_time_is_not_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    there = [True]
    now = [10.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr(served, "GONE", 5.0)
    watched = Served(lambda: there[0], "force_ctrl")
    for second, is_there in ((14.0, False), (14.9, True), (19.8, False)):
        now[0], there[0] = second, is_there
        watched.check()
    now[0] = 20.0
    with pytest.raises(IsfError, match="force_ctrl is gone") as caught:
        watched.check()
    assert caught.value.code is ErrorCode.NODE_DIED


def test_a_movement_ends_when_force_control_is_gone() -> None:
    client: Any = object.__new__(HandClient)
    client.name, client._move, client._next = "isf_1", _Action(), 0.0
    client._executor = SimpleNamespace(spin_once=lambda **_: None)
    client._held = lambda _: lambda: None
    with pytest.raises(IsfError) as caught:
        client.move_to(1, (0.0, 0.0, 0.0), 0.01, lambda _: None)
    assert caught.value.code is ErrorCode.NODE_DIED


def test_an_identification_ends_when_force_control_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = SimpleNamespace(
        add_node=lambda _: None, remove_node=lambda _: None, spin_once=lambda **_: None, destroy_node=lambda: None
    )
    for name in ("Node", "SingleThreadedExecutor"):
        monkeypatch.setattr(identify_client, name, lambda *_: nothing)
    monkeypatch.setattr(identify_client, "ActionClient", _Action)
    monkeypatch.setattr(identify_client, "join_graph", lambda _: None)
    monkeypatch.setattr(identify_client, "rclpy", SimpleNamespace(try_shutdown=lambda: None))
    settings: Any = SimpleNamespace(property=1, tool=1, repeats=1, places=np.zeros((1, 2)), max_force=100.0)
    assert set(vars(settings)) <= set(IdentifySettings.__dataclass_fields__)
    with pytest.raises(IsfError) as caught:
        identify_client.identify_in_cell(settings, lambda *_: None)
    assert caught.value.code is ErrorCode.NODE_DIED
