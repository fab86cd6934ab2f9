"""The hardware that does not exist: signs of the forces, tare, stop and the shape that a scan sees."""

from __future__ import annotations

import numpy as np
import pytest
from isf_driver_example import target_check
from isf_driver_example.hardware import FREE, PARKED, RADIUS, SQUEEZE, THICKNESS, YIELD_FORCE, ZEROS, Hardware


@pytest.fixture
def hardware() -> Hardware:
    made = Hardware(0.002)
    assert made.tare() == ""
    return made


def settled(hardware: Hardware, *tips: tuple[float, float, float]) -> np.ndarray:
    """(2, 3) N, with the tools at ``tips``; the noise of the cells is averaged out."""
    for tool, tip in enumerate(tips, 1):
        hardware.move(tool, tip)
    for _ in range(100):
        hardware.cycle()
    return np.mean([hardware.cycle() for _ in range(100)], axis=0)


def test_tools_follow_and_read_nothing_in_the_air(hardware: Hardware) -> None:
    forces = settled(hardware, (0.01, 0.0, 0.02), (0.0, 0.02, -0.02))
    assert hardware.tips == pytest.approx(np.array([[0.01, 0.0, 0.02], [0.0, 0.02, -0.02]]), abs=1e-6)
    assert np.abs(forces).max() < 0.5


def test_the_upper_tool_is_pushed_up_and_the_sheet_yields(hardware: Hardware) -> None:
    """The sheet springs back by force over stiffness, 0.3 mm, when the tool leaves."""
    forces = settled(hardware, (0.0, 0.0, -3e-3))
    assert forces[0] == pytest.approx([0.0, 0.0, YIELD_FORCE], abs=1.0)
    settled(hardware, (0.0, 0.0, PARKED))
    points = hardware.scan()
    assert points[:, 2].min() == pytest.approx(-2.7e-3, abs=1e-5)
    assert points[np.hypot(points[:, 0], points[:, 1]) > RADIUS, 2].max() == 0.0
    again = settled(hardware, (0.0, 0.0, -2.6e-3))
    assert abs(again[0, 2]) < 0.5  # no contact: it is down there already


def test_a_squeeze_pushes_the_tools_apart_with_equal_forces(hardware: Hardware) -> None:
    """At a wall of 45 deg the balls are 10 mm plus 0.707 of the thickness apart, less 0.1 mm."""
    apart = (2 * RADIUS + THICKNESS * np.sqrt(0.5) - 1e-4) * np.sqrt(0.5)
    hardware.clamp_fresh_blank()
    upper = (0.0, 0.0, 5e-3)  # clear of the sheet, so that nothing else pushes
    forces = settled(hardware, upper, (apart, 0.0, upper[2] + 2 * RADIUS - apart))
    assert forces[0] == pytest.approx(-forces[1], abs=0.5)
    assert np.linalg.norm(forces[1]) == pytest.approx(SQUEEZE * 1e-4, abs=1.0)
    assert forces[1, 0] > 0.0  # the support tool is pushed outwards
    assert forces[1, 2] < 0.0  # and down


def test_loaded_tools_cannot_be_tared(hardware: Hardware) -> None:
    settled(hardware, (0.0, 0.0, -1e-3))
    assert hardware.tare() == "a tool is loaded"
    assert np.abs(ZEROS).max() < FREE  # a cell's own zero is no load


def test_a_stop_holds_then_releases_contact_until_it_is_cleared(hardware: Hardware) -> None:
    settled(hardware, (0.0, 0.0, -1e-3))
    hardware.stop("a trial")
    hardware.move(1, (0.02, 0.0, 0.0))
    for _ in range(300):
        forces = hardware.cycle()
    assert hardware.tips[0, 2] == pytest.approx(20e-3, abs=0.5e-3)  # above the sheet
    assert hardware.tips[0, 0] == pytest.approx(0.0, abs=1e-6)  # targets are not taken
    assert np.abs(forces).max() < 2.0
    assert hardware.released
    assert hardware.tare() == ""
    hardware.move(1, (0.0, 0.0, 0.02))
    assert hardware.stopped == "a trial"  # a driver may have its operator reset it
    hardware.reset()
    assert (hardware.stopped, hardware.released) == ("", False)


def test_targets_that_were_lost_while_the_driver_stood_still_are_no_jump() -> None:
    """At 0.25 m/s: by the stamps of the targets, however soon one comes after the other, and for 0.25 s at most."""
    begin, here = np.array([0.0, 0.0, 0.02]), np.array([0.0, 0.0, 0.02])
    for stamp, step, code in (
        (1.01, 2.4e-3, 0),
        (1.01, 2.6e-3, 1402),
        (1.1, 24e-3, 0),
        (9.0, 62e-3, 0),
        (9.0, 63e-3, 1402),
    ):
        check = target_check.TargetCheck(0.01)
        assert check.check(1, "sheet", begin, here, 7.0, 1.0) is None
        fault = check.check(1, "sheet", begin + [step, 0.0, 0.0], here, 7.0, stamp)
        assert (fault[0] if fault else 0) == code


def test_a_stop_does_not_move_free_tools_however_often(hardware: Hardware) -> None:
    settled(hardware, (0.0, 0.0, 90e-3), (0.0, 0.0, -90e-3))
    for _ in range(5):
        hardware.stop("again")
        for _ in range(300):
            hardware.cycle()
        assert hardware.released
    assert hardware.tips == pytest.approx(np.array([[0.0, 0.0, 90e-3], [0.0, 0.0, -90e-3]]), abs=1e-6)
