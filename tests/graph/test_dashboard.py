"""A part formed by the node graph, watched, paused and stopped through the page's own data and commands."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell.options import RunOptions
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode
from isf_dashboard.history import COLUMNS
from isf_dashboard.server import TOKEN_VARIABLE, free_port, new_token
from quick_cone import LONGER, quick_cone
from test_run_source import unpacked
from tornado.httpclient import AsyncHTTPClient, HTTPClientError
from tornado.websocket import websocket_connect

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

LIMIT = 300.0
"""s; only to end a test that hangs."""


class Operator:
    """Looks at the page's data, pauses after the first contour, goes on, and stops in the third."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.items: dict[str, list[dict[str, Any]]] = {}
        self.status: dict[str, Any] = {}
        self.rows: list[Any] = []
        self.answers: dict[str, dict[str, Any]] = {}
        self.statuses: list[dict[str, Any]] = []
        self.messages = 0
        self.failure: BaseException | None = None

    def run(self) -> None:
        try:
            asyncio.run(asyncio.wait_for(self._work(), LIMIT))
        except BaseException as error:  # told by the test
            self.failure = error

    async def _work(self) -> None:
        while True:
            try:
                self._page = await websocket_connect(f"{self.url.replace('http', 'ws', 1)}stream")
                break
            except (OSError, HTTPClientError):  # the node has not come up
                await asyncio.sleep(0.1)
        await self._until(lambda: self.items.get("result"))
        await self._command("pause")
        await self._until(lambda: self.status.get("paused") and self.status["phase"] == "paused")
        formed = len(self.items["result"])
        since = len(self.rows)
        await self._until(lambda: len(self.rows) >= since + 10)  # half a second of the page
        assert len(self.items["result"]) == formed, "formed on while it was paused"
        await self._command("resume")
        await self._until(lambda: len(self.items["contour"]) > formed)
        await self._command("stop")
        await self._until(lambda: (self.status.get("machine") or {}).get("mode") == "protective stop")
        self.statuses.append(self.status)
        while await self._next():
            pass

    async def _command(self, name: str) -> None:
        answer = await AsyncHTTPClient().fetch(f"{self.url}command/{name}", method="POST", body="")
        self.answers[name] = json.loads(answer.body)

    async def _until(self, condition: Any) -> None:
        while not condition():
            assert await self._next(), "the page ended"

    async def _next(self) -> bool:
        text = await self._page.read_message()
        if text is None:
            return False
        told = json.loads(text)
        self.messages += 1
        if "begin" in told:
            self.items = {}
        for item in told.get("items", []):
            self.items.setdefault(item["kind"], []).append(item)
        self.status = told.get("status", self.status)
        if "samples" in told:
            self.rows += list(unpacked(told["samples"]))
        return True


def test_the_page_shows_a_part_and_pause_and_stop_act_on_the_tools(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, token = free_port(0), new_token()
    monkeypatch.setenv(TOKEN_VARIABLE, token)
    operator = Operator(f"http://127.0.0.1:{port}/{token}/")
    watching = threading.Thread(target=operator.run, daemon=True)
    watching.start()
    job = quick_cone(step=LONGER)
    result, failure = graph_run.form(job, RunOptions(seed=3), tmp_path, lambda _: None, dashboard_port=port)
    watching.join(LIMIT)
    assert operator.failure is None, operator.failure
    assert {name: answer["ok"] for name, answer in operator.answers.items()} == dict.fromkeys(
        ("pause", "resume", "stop"), True
    )
    assert "protective stop of the machine" in operator.answers["stop"]["text"]
    # the stop ended the part, the machine holds it, and the record says so
    assert failure is not None
    assert failure.code in (ErrorCode.STOP_REQUESTED, ErrorCode.STOPPED)
    record = read_bag(tmp_path / "bag")
    assert [code for code, _ in record.faults] == [ErrorCode.STOP_REQUESTED]
    assert 1 <= record.formed == result.contours < record.planned == 5
    # what the page was told is what was recorded
    items, status = operator.items, operator.statuses[0]
    assert items["job"][0]["name"] == "mini_cone"
    assert [item["index"] for item in items["contour"]] == [contour.index for contour in record.nominal]
    assert {len(items[kind]) for kind in ("target",)} == {1}
    assert {item["tool"] for item in items["path"]} == {1, 2}
    assert [item["largest"] for item in items["correction"]] == pytest.approx(
        [1e3 * np.linalg.norm(correction.offset, axis=1).max() for correction in record.corrections]
    )
    told = {item["code"] for item in items["event"] if item["severity"] == "fault"}
    assert ErrorCode.STOP_REQUESTED in told
    assert {"machine", "planner", "springback", "force_ctrl", "executive", "recorder"} <= {
        node["name"] for node in status["nodes"]
    }
    assert status["rates"]["/diagnostics"] > 1.0
    rows = np.array(operator.rows)
    assert (np.diff(rows[:, 0]) > 0.0).all()
    pressed = rows[:, COLUMNS.index("fz1")]
    assert np.nanmax(pressed) > 100.0  # N, while it formed
    assert abs(pressed[-1]) < 50.0  # N, released
    tips = rows[-3:, [COLUMNS.index(name) for name in ("x1", "y1")]]
    assert np.ptp(tips, axis=0).max() < 0.5  # mm: it leaves the sheet where it stopped, give of the machine aside
