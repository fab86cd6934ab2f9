"""``isf mode``, ``pause``, ``go-on``, ``move-to``, ``jog`` and ``zero``: an operator at a running cell."""

from __future__ import annotations

import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl.hand.jog_desk import INCREMENTS
from isf_planner.gcode.set_up import WORK_SYSTEMS

from isf_cell.commands import terminal
from isf_cell.run.hand_client import HandClient
from isf_cell.run.operator_modes import OperatorMode

WORDS = {mode.word: mode for mode in OperatorMode}

KEYS = {
    "d": (1.0, 0.0, 0.0),
    "a": (-1.0, 0.0, 0.0),
    "w": (0.0, 1.0, 0.0),
    "s": (0.0, -1.0, 0.0),
    "r": (0.0, 0.0, 1.0),
    "f": (0.0, 0.0, -1.0),
}
"""Of ``isf jog``: +x -x +y -y +z -z."""

STEPS = tuple(step for step in INCREMENTS if step > 0.0)
"""m; a terminal does not tell when a key is let go, so every key press is a step."""


def change_mode(name: str | None, job: Path | None, *, new_blank: bool, as_json: bool) -> None:
    """Set the mode of the running cell, or tell it (``name`` None); raises IsfError."""
    if name is not None and name not in WORDS:
        raise IsfError(
            ErrorCode.FILE_FIELD, f"there is no mode '{name}'", where="MODE", advice="one of " + ", ".join(WORDS)
        )
    given = load_job(job) if job is not None else None
    with HandClient() as client:
        if name is not None:
            text, base = (given.text, str(given.base.absolute())) if given is not None else ("", "")
            with terminal.console.status(f"{name}: bringing up what it needs"):
                client.set_mode(int(WORDS[name]), text, base, new_blank=new_blank)
            mode = WORDS[name].word
        else:
            state = client.state()
            mode = OperatorMode(state.mode).word
            if state.message:
                terminal.warn(state.message)
    if as_json:
        terminal.print_json({"mode": mode})
    else:
        print(mode)


def pause_part(paused: bool, *, as_json: bool) -> None:
    """Let the part that is being formed wait after its present contour, or one that waits go on; raises IsfError."""
    with HandClient() as client:
        answer = client.pause(paused)
    if as_json:
        terminal.print_json({"paused": paused, "message": answer})
    else:
        print(answer)


def move_tool(
    tool: int, position: tuple[float, float, float], speed: float, system: str | None, *, as_json: bool
) -> None:
    """Move a tip to ``position`` mm, in frame sheet or the work coordinates ``system``, at ``speed`` mm/s."""
    origin = _origin(system)
    goal = [1e-3 * value + offset for value, offset in zip(position, origin, strict=True)]
    with HandClient() as client, terminal.part_progress("move_to") as shown:
        there = client.move_to(tool, goal, 1e-3 * speed, lambda left: shown.phase(f"{1e3 * left:.2f} mm to go"))
    words = " ".join(f"{1e3 * (value - offset):.3f}" for value, offset in zip(there, origin, strict=True))
    if as_json:
        terminal.print_json({"tool": tool, "position_mm": [1e3 * value for value in there]})
    else:
        print(f"tool_{tool} at {words} mm" + (f" in {system}" if system else ""))


def jog_tool(tool: int, moves: tuple[str, ...], increment: float, speed: float, *, as_json: bool) -> None:
    """Make the steps ``moves`` (such as "+x"), or those of the keys that are pressed, of ``increment`` mm."""
    if not moves:
        _jog_by_keys(tool, increment, speed)
        return
    ways = [_way(move) for move in moves]
    with HandClient() as client:
        for way in ways:
            client.step(tool, way, 1e-3 * increment, 1e-3 * speed)
        hand = client.hand
    assert hand is not None
    tip = hand.tip_1 if tool == 1 else hand.tip_2
    if as_json:
        terminal.print_json({"tool": tool, "position_mm": [1e3 * tip.x, 1e3 * tip.y, 1e3 * tip.z]})
    else:
        print(f"tool_{tool} at {1e3 * tip.x:.3f} {1e3 * tip.y:.3f} {1e3 * tip.z:.3f} mm")


def set_zero(system: str, tool: int, axes: str, *, as_json: bool) -> None:
    """Set the origin of work coordinates ``system`` (G54 to G57) where a tip is."""
    number = _number(system)
    with HandClient() as client:
        found = client.zero(number, tool, axes)
    origin = [1e3 * found.offset.x, 1e3 * found.offset.y, 1e3 * found.offset.z]
    if as_json:
        terminal.print_json({"system": f"G{number}", "origin_mm": origin, "file": found.file})
    else:
        print(f"G{number} at {' '.join(f'{value:.3f}' for value in origin)} mm, in {found.file}")


def _jog_by_keys(tool: int, increment: float, speed: float) -> None:
    if not sys.stdin.isatty():
        raise IsfError(
            ErrorCode.FILE_FIELD, "there is no terminal whose keys could be read", where="jog", advice="name steps: +x"
        )
    terminal.say("x: a d   y: s w   z: f r   increment: - +   tool: t   end: q   (every key press is one step)")
    step = min(STEPS, key=lambda one: abs(one - 1e-3 * increment))
    with HandClient() as client, _keys_at_once():
        while True:
            terminal.console.print(f"\rtool_{tool}  step {1e3 * step:g} mm   ", end="")
            key = sys.stdin.read(1)
            if key in ("q", "\x1b", ""):
                terminal.say("")
                return
            if key == "t":
                tool = 3 - tool
            elif key in ("+", "-"):
                step = STEPS[min(max(STEPS.index(step) + (1 if key == "+" else -1), 0), len(STEPS) - 1)]
            elif key in KEYS:
                try:
                    client.step(tool, KEYS[key], step, 1e-3 * speed)
                except IsfError as error:
                    terminal.say("")
                    terminal.show_error(error)
                termios.tcflush(sys.stdin, termios.TCIFLUSH)  # keys of the time in which it moved are not made up for


@contextmanager
def _keys_at_once() -> Iterator[None]:
    """Keys come without Enter, and are not shown."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _way(move: str) -> tuple[float, float, float]:
    sign, axis = move[:1], move[1:].lower()
    if sign not in ("+", "-") or axis not in ("x", "y", "z"):
        raise IsfError(ErrorCode.FILE_FIELD, f"'{move}' is no step", where="STEP", advice="such as +x or -z")
    value = 1.0 if sign == "+" else -1.0
    x, y, z = (value if axis == name else 0.0 for name in "xyz")
    return x, y, z


def _number(system: str) -> int:
    digits = system.upper().removeprefix("G")
    if not digits.isdecimal() or int(digits) not in WORK_SYSTEMS:
        raise IsfError(ErrorCode.FILE_FIELD, f"'{system}' is no work coordinate system", advice="G54 to G57")
    return int(digits)


def _origin(system: str | None) -> tuple[float, float, float]:
    """m, of work coordinates of the running cell's rig; zero for frame sheet."""
    if system is None:
        return 0.0, 0.0, 0.0
    with HandClient() as client:
        offset = client.zero(_number(system), 1, "none").offset
    return offset.x, offset.y, offset.z
