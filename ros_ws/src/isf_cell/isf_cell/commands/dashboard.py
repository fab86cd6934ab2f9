"""``isf dashboard``: a running cell, or a recorded part, in the browser."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.text_log import LogFile, check_free
from isf_core.errors import IsfError
from isf_dashboard.history import LOGGED
from isf_dashboard.run_source import history_of
from isf_dashboard.server import (
    ADDRESS,
    DEFAULT_PORT,
    TOKEN_VARIABLE,
    DashboardServer,
    Site,
    checked_token,
    free_port,
    new_token,
)

from isf_cell.commands import terminal
from isf_cell.processes import cell_nodes, executables
from isf_cell.processes.process_group import parameter_value


def show_cell(port: int, token: str, log: Path | None, *, namespace: str | None, as_json: bool) -> None:
    """Become the node ``dashboard``; raises IsfError PORT_UNAVAILABLE, FILE_FIELD, FILE_NOT_WRITABLE, NODE_MISSING."""
    path = executables.find("isf_dashboard", "dashboard")
    token, port = checked_token(token), free_port(port)
    arguments = ["--ros-args", "-p", f"port:={port}"]
    if log is not None:
        check_free(log)
        arguments += ["-p", f"log:={parameter_value(log.absolute())}"]
    if namespace is not None:
        arguments += ["-r", executables.checked_remap(f"__ns:=/{namespace.strip('/')}")]
    arguments += cell_nodes.enclave_arguments("dashboard")
    _tell(f"http://{ADDRESS}:{port}/{token}/", as_json=as_json)
    os.environ[TOKEN_VARIABLE] = token
    sys.stdout.flush()
    os.execv(path, [str(path), *arguments])


def address_beside() -> tuple[int, str]:
    """Port and address of a page beside a run, told: the usual port where it is free, else another. The token is put
    into the environment of the node."""
    try:
        port = free_port(DEFAULT_PORT)
    except IsfError:
        port = free_port(0)
    token = os.environ[TOKEN_VARIABLE] = new_token()
    url = f"http://{ADDRESS}:{port}/{token}/"
    terminal.say(f"dashboard  {url}")
    return port, url


def show_run(run: Path, port: int, token: str, log: Path | None, *, namespace: str | None, as_json: bool) -> None:
    """Serve the recorded part ``run`` until Ctrl-C; its log is written at once.

    Raises IsfError PORT_UNAVAILABLE, FILE_FIELD, FILE_NOT_WRITABLE, BAG_UNREADABLE, BAG_INCOMPLETE.
    """
    server = None
    try:
        free_port(port)  # before what takes its time
        terminal.say(f"reading  {run}")
        history = history_of(read_bag(run, namespace))
        if log is not None:
            file = LogFile(log)
            for row in history.table():
                file.add(row[LOGGED])
            file.close()
        server = DashboardServer(Site(history), port, token)
        server.start()
        _tell(server.url, as_json=as_json)
        ended = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: ended.set())
        ended.wait()
    finally:
        if server is not None:
            server.stop()


def _tell(url: str, *, as_json: bool) -> None:
    if as_json:
        terminal.print_json({"url": url})
        sys.stdout.flush()
    terminal.say(f"dashboard  {url}")
    terminal.say("open it in a browser on this computer; Ctrl-C ends")
