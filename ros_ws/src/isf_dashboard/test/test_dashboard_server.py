"""Who may come in, and what one who may not, asks for too much or does not listen can do: nothing."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_dashboard.history import COLUMNS, History
from isf_dashboard.server import BROWSERS, PAGES, DashboardServer, Site, checked_token, free_port, new_token
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

TOKEN = "a-token-of-this-test"
LIMIT = 30.0


class Cell:
    """Counts what it was told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.go_on = threading.Event()

    async def stop(self) -> str:
        self.told.append("stop")
        return "stopped"

    async def slow(self) -> str:
        self.told.append("slow")
        while not self.go_on.is_set():
            await asyncio.sleep(0.01)
        return "done"

    async def dead(self) -> str:
        raise IsfError(ErrorCode.NODE_MISSING, "nobody is there", advice="press the emergency stop")


class Served:
    """A server and what asks it."""

    def __init__(self) -> None:
        self.history, self.cell = History("live"), Cell()
        self.history.add("event", 0.0, severity="note", text="begun")
        commands = {"stop": self.cell.stop, "slow": self.cell.slow, "dead": self.cell.dead}
        self.server = DashboardServer(Site(self.history, commands), 0, TOKEN)
        self.server.start()

    def ask(self, method: str, path: str, headers: dict[str, str] | None = None, body: Any = None) -> tuple[int, bytes]:
        status, _, text = self.answer(method, path, headers, body)
        return status, text

    def answer(self, method: str, path: str, headers: dict[str, str] | None = None, body: Any = None) -> Any:
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=LIMIT)
        try:
            connection.request(method, path, body=body, headers=headers or {})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    async def connected(self, path: str = f"/{TOKEN}/stream", **headers: str) -> Any:
        request = HTTPRequest(f"ws://127.0.0.1:{self.server.port}{path}", headers=headers)
        return await websocket_connect(request)


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.server.stop()


def test_the_page_is_there_for_who_has_the_token(served: Served) -> None:
    for name in ("", *PAGES):
        status, headers, text = served.answer("GET", f"/{TOKEN}/{name}")
        assert status == 200, name
        assert len(text) > 500
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cache-Control"] == "no-store"
        assert headers["Referrer-Policy"] == "no-referrer"
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "unsafe" not in policy
        assert "*" not in policy
    _, headers, text = served.answer("GET", f"/{TOKEN}/libraries.js", {"Accept-Encoding": "gzip"})
    assert headers["Content-Encoding"] == "gzip"
    assert len(text) < 200_000


def test_the_page_asks_for_nothing_from_elsewhere(served: Served) -> None:
    for name in PAGES:
        if name.endswith((".html", ".css")) or name in ("app.js", "scene.js", "plots.js"):
            text = served.ask("GET", f"/{TOKEN}/{name}")[1].decode()
            assert "//" not in text.replace("// ", "").replace("//\n", ""), name


@pytest.mark.parametrize("path", ["/", "/wrong/", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", "//", "/%ff/", f"/x/{TOKEN}/"])
@pytest.mark.parametrize("rest", ["", "stream", "command/stop", "log.txt", "app.js", "nothing"])
def test_without_the_token_nothing_is_told_or_done(served: Served, path: str, rest: str) -> None:
    method = "POST" if rest.startswith("command") else "GET"
    status, text = served.ask(method, path + rest)
    assert status == 403
    assert TOKEN.encode() not in text
    assert served.cell.told == []


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1.evil.example:{port}"},
        {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Origin": "http://127.0.0.1:1"},
    ],
)
def test_another_host_or_page_is_refused_with_the_token_even(served: Served, headers: dict[str, str]) -> None:
    """DNS rebinding, and a page of another server in the same browser."""
    port = str(served.server.port)
    filled = {name: value.replace("{port}", port) for name, value in headers.items()}
    assert served.ask("POST", f"/{TOKEN}/command/stop", filled)[0] == 403
    assert served.ask("GET", f"/{TOKEN}/", filled)[0] == 403
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "eA==",
    }
    assert served.ask("GET", f"/{TOKEN}/stream", {**upgrade, **filled})[0] == 403
    assert served.cell.told == []


def test_commands_are_posts_from_the_page(served: Served) -> None:
    own = {"Origin": f"http://127.0.0.1:{served.server.port}"}
    status, text = served.ask("POST", f"/{TOKEN}/command/stop", own)
    assert (status, json.loads(text)) == (200, {"ok": True, "text": "stopped"})
    for method in ("GET", "HEAD", "PUT", "DELETE"):
        assert served.ask(method, f"/{TOKEN}/command/stop")[0] == 405
    assert served.ask("POST", f"/{TOKEN}/command/explode")[0] == 404
    assert served.ask("POST", f"/{TOKEN}/")[0] == 405
    assert served.ask("GET", f"/{TOKEN}/../server.py")[0] == 404
    assert served.cell.told == ["stop"]


def test_a_command_that_fails_says_so_with_its_code(served: Served) -> None:
    status, text = served.ask("POST", f"/{TOKEN}/command/dead")
    answer = json.loads(text)
    assert status == 503
    assert (answer["ok"], answer["code"]) == (False, 1501)
    assert "press the emergency stop" in answer["text"]


def test_what_is_being_done_is_not_done_twice_and_holds_nothing_up(served: Served) -> None:
    answers: list[tuple[int, bytes]] = []
    asking = [
        threading.Thread(target=lambda: answers.append(served.ask("POST", f"/{TOKEN}/command/slow"))) for _ in range(5)
    ]
    for thread in asking:
        thread.start()
    deadline = time.monotonic() + LIMIT
    while not served.cell.told and time.monotonic() < deadline:
        pass
    assert served.ask("POST", f"/{TOKEN}/command/stop")[0] == 200
    served.cell.go_on.set()
    for thread in asking:
        thread.join(LIMIT)
    assert [status for status, _ in answers] == [200] * 5
    assert served.cell.told.count("slow") <= 5
    assert served.cell.told[0] == "slow"


def test_news_come_to_several_browsers_one_of_which_does_not_listen(served: Served) -> None:
    async def play() -> None:
        deaf = socket.create_connection(("127.0.0.1", served.server.port))
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        head = f"GET /{TOKEN}/stream HTTP/1.1\r\nHost: 127.0.0.1:{served.server.port}\r\nUpgrade: websocket\r\n"
        deaf.sendall(
            f"{head}Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: eA==\r\n\r\n".encode()
        )
        one, two = await served.connected(), await served.connected()
        for browser in (one, two):
            first = json.loads(await browser.read_message())
            assert first["items"][0]["text"] == "begun"
        for index in range(40):  # more than any buffer between: 40 x 0.5 MB
            served.history.add("scan", float(index), deviation=np.zeros(100_000))
        seen = {one: 0, two: 0}
        while min(seen.values()) < 40:
            for browser in (one, two):
                if seen[browser] < 40:
                    seen[browser] += len(json.loads(await browser.read_message()).get("items", []))
        served.history.sample(np.arange(len(COLUMNS), dtype=float))
        assert "samples" in json.loads(await one.read_message())
        one.close()
        two.close()
        deaf.close()

    asyncio.run(asyncio.wait_for(play(), LIMIT))
    assert served.ask("GET", f"/{TOKEN}/")[0] == 200


def test_there_is_an_end_to_browsers_and_to_what_one_may_send(served: Served) -> None:
    async def play() -> None:
        open_pages = [await served.connected() for _ in range(BROWSERS)]
        with pytest.raises(HTTPClientError, match="503"):
            await served.connected()
        await open_pages[0].write_message("x" * 5000)
        while await open_pages[0].read_message() is not None:
            pass
        for page in open_pages:
            page.close()

    asyncio.run(asyncio.wait_for(play(), LIMIT))
    for method, path, headers, body in (
        ("POST", f"/{TOKEN}/command/stop", {}, b"x" * 100_000),
        ("GET", f"/{TOKEN}/", {"X": "y" * 50_000}, None),
    ):
        try:
            status = served.ask(method, path, headers, body)[0]
        except ConnectionError:  # hung up before all was sent
            continue
        assert status in (400, 413, 431)
    assert served.cell.told == []


def test_a_flood_of_rubbish_leaves_the_stop_button_working(served: Served) -> None:
    rubbish = [
        b"\x00" * 100,
        b"GET",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST /%00/command/stop HTTP/1.1\r\n\r\n",
        b"\r\n" * 50,
    ]
    held = []
    for number in range(200):
        one = socket.create_connection(("127.0.0.1", served.server.port))
        one.sendall(rubbish[number % len(rubbish)])
        held.append(one)
    status, _ = served.ask("POST", f"/{TOKEN}/command/stop")
    for one in held:
        one.close()
    assert status == 200
    assert served.cell.told == ["stop"]


def test_the_log_is_a_table_of_twelve_columns(served: Served) -> None:
    for time_ in (0.0, 0.05):
        served.history.sample(np.full(len(COLUMNS), time_))
    status, headers, text = served.answer("GET", f"/{TOKEN}/log.txt")
    assert status == 200
    assert "attachment" in headers["Content-Disposition"]
    assert np.loadtxt(text.decode().splitlines()).shape == (2, 12)


def test_it_listens_on_this_computer_alone_and_gives_the_port_up(served: Served) -> None:
    with pytest.raises(IsfError, match="in use") as caught:
        DashboardServer(Site(History("run")), served.server.port)
    assert caught.value.code == ErrorCode.PORT_UNAVAILABLE
    with pytest.raises(IsfError):
        free_port(served.server.port)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as other:
        other.bind(("127.0.0.2", served.server.port))  # free: it is not bound to every address
    port = served.server.port
    served.server.stop()
    assert free_port(port) == port


@pytest.mark.parametrize(
    "token", ["short", "with/slash-and-more", "with space and more", "ümlaute-sind-kein-token", "?" * 20]
)
def test_a_token_that_cannot_stand_in_an_address_is_refused(token: str) -> None:
    with pytest.raises(IsfError) as caught:
        checked_token(token)
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_tokens_differ() -> None:
    tokens = {new_token() for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 32
    assert all(checked_token(token) == token for token in tokens)


def test_a_button_that_asks_for_what_is_no_number_leaves_the_page_its_socket(served: Served) -> None:
    asked: list[int] = []

    def jog(_: str, values: Mapping[str, Any]) -> None:
        asked.append(int(values["tool"]))

    served.server.stop()
    served.server = DashboardServer(Site(served.history, {}, jog), 0, TOKEN)
    served.server.start()

    async def press() -> None:
        socket = await served.connected()
        for text in ('{"jog":{"tool":1e999}}', '{"jog":{"tool":"x"}}', '{"jog":{"tool":2}}'):
            await socket.write_message(text)
        for _ in range(int(LIMIT / 0.05)):
            if asked:
                break
            await asyncio.sleep(0.05)
        socket.close()

    asyncio.run(press())
    assert asked == [2]
