"""Measurements made by the tools between contours: a sequence of small moves, one row per control tick.

A measurement begins and ends where the tools are at rest. While it runs all offsets stand still, so that a tool that
returns to its planned tip returns to its commanded one.
"""

from __future__ import annotations

from typing import Protocol

from isf_core.errors import ErrorCode

from isf_force_ctrl.segments import Row


class Measurement(Protocol):
    """What the controller plays in place of a contour."""

    @property
    def phase(self) -> str:
        """What is being done, for people."""

    @property
    def ended(self) -> bool:
        """True when no more rows will come."""

    @property
    def code(self) -> ErrorCode:
        """OK, or why it did not succeed."""

    @property
    def message(self) -> str:
        """Text of the code; empty when OK."""

    def step(self, forces: tuple[float, ...]) -> Row:
        """Row of the next tick from the ``forces`` (6,) N of the sheet on tool 1 and tool 2 at the present one."""

    def give_up(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        """End early: come to rest and ``stay`` there, or return to the begin first."""
