"""A real browser without a screen, driven over the DevTools protocol; for tests of pages."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
)
LIMIT = 60.0
"""s; only to end a test that hangs."""


def installed() -> str | None:
    """Path of a browser, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


needed = pytest.mark.skipif(
    installed() is None,
    reason="without Chromium the page is not looked at; .ci/run installs it, elsewhere: apt install chromium",
)
"""Mark of tests that look at a page."""


class Browser:
    """One page. ``errors`` holds what it told as errors or did not load."""

    def __init__(self, folder: Path, *, width: int = 1400, height: int = 1000) -> None:
        path = installed()
        assert path is not None
        self.errors: list[str] = []
        self._loop = asyncio.new_event_loop()
        self._number = 0
        command = [path, *ARGUMENTS, f"--user-data-dir={folder}", f"--window-size={width},{height}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._socket: WebSocketClientConnection = self._loop.run_until_complete(self._connected(folder))
        for name in ("Runtime", "Page", "Network", "Log"):
            self.call(f"{name}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._loop.run_until_complete(self._left())
        self._process.terminate()
        self._process.wait(10.0)
        self._loop.close()

    async def _left(self) -> None:
        self._socket.close()

    def call(self, method: str, **parameters: Any) -> Any:
        """Result of a method of the protocol."""
        return self._loop.run_until_complete(self._call(method, parameters))

    def value(self, script: str) -> Any:
        """Value of a script, awaited if it is a promise."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, script: str) -> Any:
        """Value of ``script`` as soon as it is true; it may fail before, as while a page is loaded."""
        deadline = time.monotonic() + LIMIT
        while True:
            found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
            if "exceptionDetails" not in found and found["result"].get("value"):
                return found["result"]["value"]
            assert time.monotonic() < deadline, (script, found)
            self._loop.run_until_complete(asyncio.sleep(0.05))

    def look(self, width: int, height: int, *, scheme: str = "light") -> None:
        """Size of the page in its own pixels, and scheme of its colours."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def picture(self, path: Path) -> None:
        """Save what is seen."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    async def _connected(self, folder: Path) -> WebSocketClientConnection:
        deadline = time.monotonic() + LIMIT
        told = folder / "DevToolsActivePort"
        while not (told.is_file() and told.read_text().count("\n") == 1):
            assert self._process.poll() is None, "the browser ended"
            assert time.monotonic() < deadline
            await asyncio.sleep(0.05)
        port, address = told.read_text().split("\n")
        whole = await websocket_connect(f"ws://127.0.0.1:{port}{address}")
        await whole.write_message(json.dumps({"id": 1, "method": "Target.getTargets"}))
        page = ""
        while not page:
            answer = json.loads(await whole.read_message() or "{}")
            targets = answer.get("result", {}).get("targetInfos", [])
            page = next((target["targetId"] for target in targets if target["type"] == "page"), "")
        whole.close()
        return await websocket_connect(f"ws://127.0.0.1:{port}/devtools/page/{page}", max_message_size=100_000_000)

    async def _call(self, method: str, parameters: dict[str, Any]) -> Any:
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), LIMIT)
            assert text is not None, "the browser ended"
            message = json.loads(text)
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, said = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(said["exceptionDetails"].get("exception", said))[:500])
        elif method == "Runtime.consoleAPICalled" and said["type"] == "error":
            self.errors.append(json.dumps(said["args"])[:500])
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.errors.append(said["entry"]["text"])
        elif method == "Network.loadingFailed" and not said.get("canceled"):
            self.errors.append(said["errorText"])
