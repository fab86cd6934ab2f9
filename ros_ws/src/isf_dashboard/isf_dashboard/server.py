"""The page and its data over HTTP, for this computer alone.

Every request has to name this computer (``Host``, against names that are made to point here), come from the page itself
where a browser says from where (``Origin``), and carry the token as the first part of its path, which is compared in
constant time. What changes something is a POST. The news go through a WebSocket per browser, each at its own pace: it
gets the next ones when it has taken the last.
"""

from __future__ import annotations

import asyncio
import gzip
import hmac
import json
import mimetypes
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from http.client import responses
from importlib import resources
from typing import Any

from isf_analysis.bag.text_log import HEADER, lines
from isf_core.errors import ErrorCode, IsfError, coded
from tornado import web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from isf_dashboard.history import LOGGED, Cursor, History

ADDRESS = "127.0.0.1"
DEFAULT_PORT = 8750

RATE = 20.0
"""Hz, updates of a page."""

SIGN_OF_LIFE = 1.0
"""s after which a message is sent although there is no news: a page tells from it that what it shows is not old."""

GOING_AWAY = 1001
"""Code of a WebSocket whose server ends (RFC 6455, 7.4.1): the page tells it from a connection that was lost."""

BROWSERS = 16
"""At a time; one more is refused."""

TOKEN_VARIABLE = "ISF_DASHBOARD_TOKEN"
"""Of the environment, for the token of the node: a parameter would be told to everybody in the graph, and recorded."""

SHORTEST_TOKEN = 16
"""Characters of a token that is given."""

PAGES = ("index.html", "style.css", "app.js", "scene.js", "plots.js", "libraries.js", "licences.txt")

Command = Callable[[], Awaitable[str]]
"""Does what it is for and says in a sentence what was done; raises IsfError."""


Jog = Callable[[str, Mapping[str, Any]], None]
"""Told by a page: ``enable``, ``tool``, ``way`` (3 numbers), ``increment`` in mm."""

LONGEST_WORD = 500
"""Characters of what a page may say at a time."""


@dataclass(frozen=True)
class Site:
    """What a server shows: the ``history``, and ``commands`` by name; a recorded part has none.

    ``jog`` is called with the name of a page and what its button asks for, again and again while it is held.
    """

    history: History
    commands: Mapping[str, Command] = field(default_factory=dict)
    jog: Jog | None = None


def new_token() -> str:
    """A token nobody can guess: 192 bits."""
    return secrets.token_urlsafe(24)


def checked_token(token: str) -> str:
    """``token``, or a new one where it is empty; raises IsfError FILE_FIELD for one that cannot be used."""
    if not token:
        return new_token()
    if len(token) < SHORTEST_TOKEN or not all(char.isascii() and (char.isalnum() or char in "-_") for char in token):
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"a token has {SHORTEST_TOKEN} or more letters, digits, - and _",
            where="token",
            advice="leave it out: a random one is made",
        )
    return token


def free_port(port: int) -> int:
    """``port``, or for 0 one that is free; raises IsfError PORT_UNAVAILABLE."""
    sockets = _bound(port)
    number = int(sockets[0].getsockname()[1])
    for one in sockets:
        one.close()
    return number


class DashboardServer:
    """Serves ``site`` from a thread of its own until :meth:`stop`.

    Attributes
    ----------
    url : of the page, with the token ; port : that it has
    """

    def __init__(self, site: Site, port: int = DEFAULT_PORT, token: str = "") -> None:
        """Take the port; 0: any. Raises IsfError PORT_UNAVAILABLE, FILE_FIELD."""
        self._token = checked_token(token)
        self._sockets = _bound(port)
        self.port = int(self._sockets[0].getsockname()[1])
        self._gate = _Gate(site, self._token, self.port)
        self.url = f"http://{ADDRESS}:{self.port}/{self._token}/"
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dashboard", daemon=True)

    @property
    def browsers(self) -> int:
        """Pages that are open now."""
        return len(self._gate.open)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()
        self._ready.wait()

    def stop(self) -> None:
        """Close all connections and give up the port."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        for one in self._sockets:
            one.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(self._serve())
        self._ready.set()
        self._loop.run_forever()
        server.stop()
        self._loop.run_until_complete(self._end(server))
        self._loop.close()

    async def _serve(self) -> HTTPServer:
        gate = {"gate": self._gate}
        application = web.Application(
            [
                (r"/[^/]*/stream", _Stream, gate),
                (r"/[^/]*/command/([a-z0-9_]+)", _CommandPost, gate),
                (r"/[^/]*/log\.txt", _Log, gate),
                (r"/[^/]*/([a-z_.]*)", _Page, gate),
            ],
            default_handler_class=_Nothing,
            default_handler_args=gate,
            websocket_ping_interval=5.0,
            websocket_max_message_size=1024,
            log_function=lambda _: None,
        )
        server = HTTPServer(
            application, max_body_size=1024, max_header_size=16_384, idle_connection_timeout=60.0, body_timeout=5.0
        )
        server.add_sockets(self._sockets)
        return server

    async def _end(self, server: HTTPServer) -> None:
        for stream in list(self._gate.open):
            stream.close(GOING_AWAY)
        await server.close_all_connections()
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class _Gate:
    """Who may come in, and what is there."""

    def __init__(self, site: Site, token: str, port: int) -> None:
        self.site = site
        self.open: set[_Stream] = set()
        self.running: dict[str, asyncio.Task[str]] = {}
        self._token = token.encode()
        self._hosts = {f"{name}:{port}" for name in (ADDRESS, "localhost")}
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts))
        self.policy = (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
            f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )

    def refusal(self, handler: web.RequestHandler) -> str | None:
        """Why a request is refused; None: it may come in."""
        request = handler.request
        given = request.path.split("/")[1].encode("utf-8", "surrogateescape")
        allowed = hmac.compare_digest(given, self._token)
        if (request.host or "").lower() not in self._hosts:
            return "not for this host"
        origin = request.headers.get("Origin")
        if origin is not None and origin.lower() not in {f"http://{host}" for host in self._hosts}:
            return "not from this page"
        return None if allowed else "the token is missing or wrong: use the address that was printed at the start"


class _Handler(web.RequestHandler):
    """What all answers have in common."""

    gate: _Gate

    def initialize(self, gate: _Gate) -> None:
        self.gate = gate

    def prepare(self) -> None:
        if (why := self.gate.refusal(self)) is not None:
            self.set_status(403)
            self.finish(f"{why}\n")

    def set_default_headers(self) -> None:
        self.set_header("Server", "isf")
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Opener-Policy", "same-origin")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("X-Frame-Options", "DENY")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.finish(f"{status_code} {responses.get(status_code, '')}\n")


class _Nothing(_Handler):
    """What is not there."""

    def prepare(self) -> None:
        if self.gate.refusal(self) is None:
            raise web.HTTPError(404)
        super().prepare()


class _Page(_Handler):
    """Page, style and scripts."""

    async def get(self, name: str) -> None:
        name = name or "index.html"
        if name not in PAGES:
            raise web.HTTPError(404)
        plain, packed = _file(name)
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.set_header("Content-Security-Policy", self.gate.policy)
        self.set_header("Vary", "Accept-Encoding")
        if "gzip" in self.request.headers.get("Accept-Encoding", ""):
            self.set_header("Content-Encoding", "gzip")
            plain = packed
        await self.finish(plain)


class _Log(_Handler):
    """The samples that are kept, as the log of the source."""

    async def get(self) -> None:
        self.set_header("Content-Disposition", 'attachment; filename="isf_log.txt"')
        self.write(f"{HEADER}\n")
        table = self.gate.site.history.table()
        for begin in range(0, len(table), 2000):
            self.write("".join(lines(table[begin : begin + 2000, LOGGED])))
            await self.flush()


class _CommandPost(_Handler):
    """A command. While it is being carried out the same one waits for its answer: it is not done twice."""

    async def post(self, name: str) -> None:
        command = self.gate.site.commands.get(name)
        if command is None:
            raise web.HTTPError(404)
        running = self.gate.running
        if name not in running:
            running[name] = asyncio.ensure_future(command())
            running[name].add_done_callback(lambda _: running.pop(name, None))
        try:
            answer: dict[str, Any] = {"ok": True, "text": await asyncio.shield(running[name])}
        except Exception as failure:
            error = coded(failure, where=f"command {name}")
            self.set_status(503)
            answer = {"ok": False, "code": int(error.code), "text": str(error)}
        self.set_header("Content-Type", "application/json; charset=utf-8")
        await self.finish(json.dumps(answer))


class _Stream(WebSocketHandler):
    """The news, to one browser."""

    gate: _Gate

    def initialize(self, gate: _Gate) -> None:
        self.gate = gate
        self._task: asyncio.Task[None] | None = None

    def prepare(self) -> None:
        if (why := self.gate.refusal(self)) is not None:
            self.set_status(403)
            self.finish(f"{why}\n")
        elif len(self.gate.open) >= BROWSERS:
            self.set_status(503)
            self.finish(f"{BROWSERS} pages are open already: close one\n")

    def check_origin(self, origin: str) -> bool:
        return True  # prepare() has done so, more strictly

    def open(self, *_: str, **__: str) -> None:  # type: ignore[override]
        self.gate.open.add(self)
        self.set_nodelay(True)
        self._task = asyncio.ensure_future(self._tell())

    def on_message(self, message: str | bytes) -> None:
        """A jog button is held, or was let go; what is none is left alone."""
        jog = self.gate.site.jog
        if jog is None or not isinstance(message, str) or len(message) > LONGEST_WORD:
            return
        with suppress(ValueError, TypeError, KeyError, OverflowError):  # the last for 1e999, which is no integer
            jog(f"page {id(self) % 10_000}", dict(json.loads(message)["jog"]))

    def on_close(self) -> None:
        self.gate.open.discard(self)
        if self._task is not None:
            self._task.cancel()

    async def _tell(self) -> None:
        """One message after the other: the next one when the last has left. What comes meanwhile is in the history."""
        cursor, loop = Cursor(), asyncio.get_running_loop()
        due = sent = loop.time()
        try:
            while True:
                text = self.gate.site.history.news(cursor)
                if text is not None or due - sent > SIGN_OF_LIFE:
                    sent = due
                    await self.write_message(text or "{}")
                due = max(due + 1.0 / RATE, loop.time())
                await asyncio.sleep(due - loop.time())
        except WebSocketClosedError:
            pass


@cache
def _file(name: str) -> tuple[bytes, bytes]:
    """A file of the page as it is, and packed (gzip)."""
    plain = resources.files("isf_dashboard").joinpath("page", name).read_bytes()
    return plain, gzip.compress(plain, 9, mtime=0)


def _bound(port: int) -> list[socket.socket]:
    try:
        return bind_sockets(port, ADDRESS)
    except (OSError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) else "there is no such port"
        raise IsfError(
            ErrorCode.PORT_UNAVAILABLE,
            f"port {port} cannot be used: {reason}",
            where="--port",
            advice="another dashboard may be open: close it, or choose another port; 0 takes any that is free",
        ) from error
