"""The forming in the report, in a real browser: chosen, gone through by keys, played and paused, without errors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import headless_browser
import pytest
from headless_browser import Browser
from isf_analysis.figures import style
from isf_analysis.report.page import write_report
from synthetic_part import make_part

pytestmark = headless_browser.needed

CONTOURS = 6
DEEPEST = "Math.min(...[...document.querySelector('.view3d-plot').data[{trace}].z].flatMap((row) => [...row]))"
STEPS = """
(() => {
  const data = document.querySelector(".view3d-plot").data;
  const seen = data.map((one, k) => [one, k]).filter(([one]) => one.visible);
  return seen.map(([one, k]) => [k, one.type, one.name ?? ""]);
})()
"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("plotly")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "DPI", 34)
        part = make_part(contours=CONTOURS, spacing=4e-3, correction="none")
        return write_report(part, tmp_path_factory.mktemp("report")).html


@pytest.fixture
def page(report: Path, tmp_path: Path) -> Iterator[Browser]:
    with Browser(tmp_path) as browser:
        browser.call("Page.navigate", url=report.as_uri())
        browser.until("document.readyState === 'complete' && !!document.querySelector('.view3d')")
        browser.value("document.querySelector('.view3d').scrollIntoView()")
        browser.until("!document.querySelector('.view3d-note')")
        yield browser


def words(page: Browser) -> str:
    return str(page.value("document.querySelector('.view3d-steps output').textContent"))


def button(page: Browser) -> str:
    return str(page.value("document.querySelector('.view3d-steps button').textContent"))


def press(page: Browser, key: str, code: int) -> None:
    for kind in ("keyDown", "keyUp"):
        more: dict[str, Any] = {"text": " "} if key == " " and kind == "keyDown" else {}
        page.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **more)


def choose(page: Browser, view: str) -> None:
    page.value(f"document.querySelector('input[value=\"{view}\"]').click()")


def show_forming(page: Browser) -> int:
    """Choose it; the number of the trace of the sheet."""
    assert page.value("document.querySelector('.view3d-steps').hidden")
    choose(page, "forming")
    page.until("!document.querySelector('.view3d-steps').hidden && document.querySelector('output').textContent !== ''")
    seen = page.value(STEPS)
    assert [name for _, _, name in seen if name] == [
        "path of the upper tool",
        "upper tool",
        "path of the lower tool",
        "lower tool",
    ]
    return int(seen[0][0])


def test_steps_by_keys_show_the_sheet_of_each_contour(page: Browser) -> None:
    trace = show_forming(page)
    assert words(page) == f"contour 1 of {CONTOURS}, planned 3.5 mm deep: swept by the tools, not measured"
    page.value("document.querySelector('.view3d-steps input').focus()")
    deepest = [page.value(DEEPEST.format(trace=trace))]
    for number in range(2, CONTOURS + 1):
        press(page, "ArrowRight", 39)
        page.until(f"document.querySelector('output').textContent.startsWith('contour {number} of')")
        page.until(f"{DEEPEST.format(trace=trace)} < {deepest[-1]} - 1.0")
        deepest.append(page.value(DEEPEST.format(trace=trace)))
    # the tip of a ball of 5 mm lies 5 (1 - cos 50 deg) below its contact
    assert deepest == pytest.approx([-3.5 * k - 1.786 for k in range(1, CONTOURS + 1)], abs=0.02)
    press(page, "End", 35)
    page.until("document.querySelector('output').textContent === 'finished part: as scanned'")
    assert page.errors == []


def test_nothing_moves_by_itself_and_space_plays_and_pauses(page: Browser) -> None:
    show_forming(page)
    assert button(page) == "Play"
    page.value("document.querySelector('.view3d-steps input').focus()")
    press(page, " ", 32)
    assert button(page) == "Pause"
    page.until("document.querySelector('output').textContent.startsWith('contour 3 of')")
    press(page, " ", 32)
    assert button(page) == "Play"
    stopped = words(page)
    page.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert words(page) == stopped
    page.value("document.querySelector('.view3d-steps button').click()")
    page.until("document.querySelector('output').textContent === 'finished part: as scanned'")
    page.until("document.querySelector('.view3d-steps button').textContent === 'Play'")
    choose(page, "deviation")
    page.until("document.querySelector('.view3d-steps').hidden")
    assert page.errors == []


def test_a_reader_who_wants_no_motion_gets_whole_steps(page: Browser) -> None:
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    trace = show_forming(page)
    page.value(
        "window.places = new Set(); document.querySelector('.view3d-plot').on('plotly_restyle', "
        f"() => window.places.add(document.querySelector('.view3d-plot').data[{trace + 2}].x[0][0]))"
    )
    page.value("document.querySelector('.view3d-steps button').click()")
    page.until("document.querySelector('output').textContent.startsWith('contour 4 of')")
    page.value("document.querySelector('.view3d-steps button').click()")
    assert 1 <= page.value("window.places.size") <= 4  # the ball is at the end of a contour, never on its way
    assert page.errors == []
