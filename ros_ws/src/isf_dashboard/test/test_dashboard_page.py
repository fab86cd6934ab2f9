"""The page in a real browser: it draws, it stops, it fits a phone, and it says when nobody answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import headless_browser
import numpy as np
import pytest
from headless_browser import Browser
from isf_analysis.measures.record import PartRecord
from isf_dashboard.history import COLUMNS, History
from isf_dashboard.part_feed import PartFeed
from isf_dashboard.run_source import history_of
from isf_dashboard.server import DashboardServer, Site
from synthetic_part import make_events, make_part

pytestmark = headless_browser.needed

DRAWN = """
(() => {
  const canvas = document.getElementById("scene");
  const copy = document.createElement("canvas");
  [copy.width, copy.height] = [canvas.width, canvas.height];
  const pen = copy.getContext("2d");
  return new Promise((done) => requestAnimationFrame(() => {
    pen.drawImage(canvas, 0, 0);
    const pixels = pen.getImageData(0, 0, copy.width, copy.height).data;
    const seen = new Set();
    for (let k = 0; k < pixels.length; k += 4 * 37) {
      seen.add(`${pixels[k] >> 4},${pixels[k + 1] >> 4},${pixels[k + 2] >> 4}`);
    }
    done(seen.size);
  }));
})()
"""
"""Number of different colours in the picture of the part."""

LINES = """
[...document.querySelectorAll(".uplot canvas")].map((canvas) => {
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let inked = 0;
  for (let k = 3; k < pixels.length; k += 4) inked += pixels[k] > 0 ? 1 : 0;
  return inked;
})
"""
"""Pixels with ink of every plot."""


def key(browser: Browser, name: str) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, text=name if len(name) == 1 else "")


def text(browser: Browser, name: str) -> str:
    return str(browser.value(f"document.getElementById('{name}').textContent"))


class Cell:
    """Says what it was told."""

    def __init__(self, history: History) -> None:
        self.told: list[str] = []
        self.jogs: list[tuple[str, dict[str, Any]]] = []
        self.history = history

    def commands(self) -> dict[str, Any]:
        modes = ("mode_automatic", "mode_manual", "mode_set_up", "mode_simulation", "zero_55_2")
        return {name: self._doing(name) for name in ("stop", "pause", "resume", *modes)}

    def jog(self, page: str, asked: Mapping[str, Any]) -> None:
        self.jogs.append((page, dict(asked)))

    def _doing(self, name: str) -> Any:
        async def do() -> str:
            self.told.append(name)
            return f"{name} is done"

        return do


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("browser")) as made:
        yield made


@pytest.fixture(scope="module")
def part() -> PartRecord:
    made = make_part()
    return made.__class__(**{**vars(made), "events": make_events(made)})


def test_a_recorded_part_is_drawn_and_played(browser: Browser, part: PartRecord, tmp_path: Path) -> None:
    server = DashboardServer(Site(history_of(part)), 0)
    server.start()
    try:
        browser.look(1400, 1000)
        browser.call("Page.navigate", url=server.url)
        browser.errors.clear()  # of the page before
        browser.until("Number(document.documentElement.dataset.results) === 42")
        browser.until(f"({DRAWN.strip()}).then((count) => count > 12)")
        browser.until(f"({LINES.strip()}).every((inked) => inked > 2000)")
        assert text(browser, "contours") == "42 of 42 contours"
        assert "mm mean" in text(browser, "scan")
        assert browser.value("getComputedStyle(document.getElementById('operator')).display") == "none"
        browser.value("(() => { const s = document.getElementById('slider'); s.value = s.max / 2;"
                      " s.dispatchEvent(new Event('input')); })()")  # fmt: skip
        browser.until("/^contour 18 of 42/.test(document.getElementById('contours').textContent)")
        browser.value("document.getElementById('speed').value = '64'")
        key(browser, " ")
        browser.until("document.getElementById('contours').textContent === '42 of 42 contours'")
        for width in (390, 320):
            browser.look(width, 800, scheme="dark")
            browser.until(f"innerWidth === {width}")
            assert browser.value("document.documentElement.scrollWidth") <= width
        assert browser.errors == []
    finally:
        server.stop()


def test_a_running_cell_is_stopped_by_button_and_key(browser: Browser, part: PartRecord) -> None:
    history = History("live")
    cell, feed = Cell(history), PartFeed(history)
    assert part.target is not None
    feed.target(0.0, part.target)
    feed.nominal(0.0, part.nominal[0])
    row = np.zeros(len(COLUMNS))
    row[COLUMNS.index("theta1")] = 20.0
    status = {"heard": True, "busy": True, "paused": False, "phase": "forming", "ready": {"stop": True, "pause": True}}
    node = {"name": "machine", "level": 0, "state": "active", "text": "<b>ok</b>", "silent": False, "values": {}}
    history.set_status({**status, "nodes": [node], "rates": {"tool_1/pose": 50}})
    server = DashboardServer(Site(history, cell.commands()), 0)
    server.start()
    try:
        browser.look(390, 844)
        browser.call("Page.navigate", url=server.url)
        browser.errors.clear()  # of the page before
        history.sample(row)
        browser.until("Number(document.documentElement.dataset.samples) >= 1")
        browser.until("!document.getElementById('tilt-row').hidden")
        assert browser.value("document.documentElement.scrollWidth") <= 390
        size = browser.value("(() => { const r = document.getElementById('stop').getBoundingClientRect();"
                             " return [r.width, r.height, r.bottom <= innerHeight]; })()")  # fmt: skip
        assert size[0] >= 150
        assert size[1] >= 48
        assert size[2], "the stop button is out of sight"
        browser.value("document.getElementById('stop').click()")
        browser.until("document.getElementById('answer').textContent === 'stop is done'")
        key(browser, "Escape")
        key(browser, "s")
        key(browser, " ")
        browser.until("document.getElementById('answer').textContent === 'pause is done'")
        assert cell.told[0] == "stop"
        assert sorted(set(cell.told)) == ["pause", "stop"]
        assert 2 <= cell.told.count("stop") <= 3  # one that comes while another is carried out joins it
        history.set_status({**status, "paused": True})
        browser.until("document.getElementById('pause').textContent === 'Resume'")
        key(browser, " ")  # does not go on: it leads to the button
        assert browser.value("document.activeElement.id") == "pause"
        assert "resume" not in cell.told
        browser.value("document.activeElement.click()")
        browser.until("document.getElementById('answer').textContent === 'resume is done'")
        assert browser.value("document.querySelectorAll('#nodes b').length") == 0  # text stays text
        assert browser.errors == []
    finally:
        server.stop()
    browser.until("!document.getElementById('alert').hidden")
    assert "has ended" in text(browser, "alert-text")
    key(browser, "Escape")
    browser.until("document.getElementById('alert-text').textContent.includes('emergency stop')")
    browser.value("document.getElementById('seen').click()")
    assert browser.value("document.getElementById('alert').hidden")


def place_of(browser: Browser, chosen: str) -> dict[str, float]:
    """Middle of an element, after it was scrolled into view."""
    found = browser.value(
        f"(() => {{ const e = document.querySelector('{chosen}'); e.scrollIntoView({{block: 'center'}});"
        " const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    return {"x": found[0], "y": found[1]}


def test_an_operator_jogs_as_long_as_the_button_is_held_and_can_always_stop(browser: Browser) -> None:
    history = History("live")
    cell = Cell(history)
    mode = {"word": "automatic", "changing": False, "job": "cone", "text": ""}
    hand = {"armed": False, "moving": False, "client": "", "code": 0, "text": ""}
    status = {"heard": True, "busy": False, "paused": False, "phase": "", "ready": {"stop": True, "pause": False}}
    status |= {"nodes": [], "rates": {}}
    history.set_status({**status, "mode": mode, "hand": hand})
    server = DashboardServer(Site(history, cell.commands(), cell.jog), 0)
    server.start()
    disabled = "[...document.querySelectorAll('[data-way]')].every((button) => button.disabled)"
    try:
        browser.look(390, 844)
        browser.call("Page.navigate", url=server.url)
        browser.errors.clear()  # of the page before
        browser.until("!document.getElementById('hand-section').hidden")
        browser.until("document.querySelector('[data-mode=automatic]').classList.contains('on')")
        assert browser.value(disabled)
        assert browser.value("document.getElementById('zero').disabled")
        assert browser.value("document.documentElement.scrollWidth") <= 390
        browser.value("document.querySelector('[data-mode=manual]').click()")
        browser.until("document.getElementById('answer').textContent === 'mode_manual is done'")
        browser.value("document.querySelector('[data-mode=set-up]').click()")
        browser.until("document.getElementById('answer').textContent === 'mode_set_up is done'")
        manual = {**status, "mode": {**mode, "word": "manual"}, "hand": {**hand, "armed": True}}
        history.set_status(manual)
        browser.until(f"!({disabled})")
        browser.value(
            "document.getElementById('jog-step').value = '0.1'; document.getElementById('jog-tool').value = '2'"
        )
        assert cell.jogs == [], "nothing was pressed"
        place = place_of(browser, '[data-way="0,0,-1"]')
        mouse = {**place, "button": "left", "buttons": 1, "clickCount": 1}
        browser.call("Input.dispatchMouseEvent", type="mousePressed", **mouse)
        for _ in range(10_000):
            if len(cell.jogs) >= 4:
                break
            browser.value("1")  # the button is held meanwhile
        browser.call("Input.dispatchMouseEvent", type="mouseReleased", **mouse)
        browser.until("!document.querySelector('.held')")
        browser.value("document.getElementById('zero-system').value = 'G55'")
        browser.value("document.getElementById('zero').click()")
        browser.until("document.getElementById('answer').textContent === 'zero_55_2 is done'")
        told = [asked for _, asked in cell.jogs]
        assert len({page for page, _ in cell.jogs}) == 1
        assert told[0] == {"enable": True, "tool": 2, "way": [0, 0, -1], "increment": 0.1}
        assert len(told) >= 3, "the button was held: it is told again and again"
        assert told[-1]["enable"] is False
        assert told[-1]["way"] == [0, 0, 0]
        assert all(asked == told[0] for asked in told[:-1])
        # a stop ends the jog, by key while the button is held; and it is in sight
        browser.call("Input.dispatchMouseEvent", type="mousePressed", **{**mouse, **place_of(browser, "[data-way]")})
        browser.until("!!document.querySelector('.held')")
        key(browser, "Escape")
        browser.until("!document.querySelector('.held')")
        browser.until("document.getElementById('answer').textContent === 'stop is done'")
        assert cell.jogs[-1][1]["enable"] is False
        assert browser.value("(() => { const r = document.getElementById('stop').getBoundingClientRect();"
                             " return r.top >= 0 && r.bottom <= innerHeight && r.width >= 150; })()")  # fmt: skip
        # what the cell says ends it, too, and why is told
        browser.call("Input.dispatchMouseEvent", type="mouseReleased", **mouse)
        history.set_status({**manual, "hand": {**hand, "armed": False, "text": "tool_1 has touched"}})
        browser.until(disabled)
        assert text(browser, "hand-text") == "tool_1 has touched"
        assert browser.errors == []
    finally:
        server.stop()
