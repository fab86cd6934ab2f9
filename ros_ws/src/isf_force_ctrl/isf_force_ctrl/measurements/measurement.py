"""Measurements made by the tools between contours: a sequence of small moves, one row per control tick.

:class:`Measurement` is what the controller asks for, :class:`Probe` a measurement written as a program of moves,
:class:`Glide` a straight move whose end is not known beforehand. Measurements of other packages, which actions of the
node begin, are found by name (:func:`load_measurement`)::

    entry_points={"isf_force_ctrl.measurements": ["identify = my_package.my_module:MyMeasurement"]}

Frame ``sheet``, SI units.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
from isf_core.contour import Contour
from isf_core.errors import ErrorCode, IsfError
from isf_core.types import Array

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.control_state import Targets
from isf_force_ctrl.motion import tool_moves
from isf_force_ctrl.motion.segments import Column, Row, posture_of, rows_of
from isf_force_ctrl.motion.tool_moves import Posture, Tools
from isf_force_ctrl.motion.trajectory import Motion


@dataclass(frozen=True)
class Stand:
    """How the tools stand: which, the sheet's normal (3,) there, and whether they are ``clear`` of it."""

    tools: Tools
    lift_normal: Array
    clear: bool


@dataclass(frozen=True)
class AtRest:
    """Where a measurement begins.

    Attributes
    ----------
    config : of the controller ; row : that is commanded ; stand : of the tools
    formed : contour formed last, None on an unformed blank
    """

    config: ControlConfig
    row: Row
    stand: Stand
    formed: Contour | None


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

    @property
    def stand(self) -> Stand:
        """Of the tools after the last step."""

    @property
    def keeps_offsets(self) -> bool:
        """True when the offsets of force loop and compliance stay as they are; else they go back to zero."""

    def step(self, time: float, targets: Targets, forces: tuple[float, ...]) -> Row:
        """Row of the next tick from ``forces`` (6,) N of the sheet on tool 1 and tool 2 at the present one.

        ``time`` s is the present one, ``targets`` what was commanded for it, offsets included.
        """

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:
        """The machine has reported the ``tip`` (3,) m of ``tool`` (1, 2) at ``time`` s."""

    def give_up(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        """End early: come to rest and ``stay`` there, or return to the begin first."""


GROUP = "isf_force_ctrl.measurements"


def load_measurement(name: str) -> Any:
    """What is registered as measurement ``name``; raises IsfError MEASUREMENT_REFUSED when nothing can be loaded."""
    found = [entry for entry in entry_points(group=GROUP) if entry.name == name]
    try:
        return found[0].load()
    except Exception as error:  # another package may fail in any way while it is loaded
        why = f"{type(error).__name__}: {error}" if found else "no package that is installed has it"
        raise IsfError(
            ErrorCode.MEASUREMENT_REFUSED,
            f"the measurement '{name}' cannot be loaded: {why}",
            where=found[0].value if found else name,
            advice="install the package that registers it, such as isf_identify",
        ) from error


Program = Iterator[Row]

ACCELERATION = 0.05
"""m/s^2 of moves in contact: a tenth of what a contour may have."""


class Probe(ABC):
    """Base of measurements that begin anywhere and end with the tools parked.

    ``both_tools``: both take part; else the other tool than the forming one stays where it is, or there is none.
    """

    keeps_offsets = False

    def __init__(self, rest: AtRest, *, both_tools: bool = True) -> None:
        self.config, stand = rest.config, rest.stand
        self.row = list(rest.row)
        """Commanded for the present tick."""
        self.row[Column.SET_POINT] = self.row[Column.COORDINATE] = float("nan")
        self.row[Column.SPEED] = self.row[Column.LEARNED] = 0.0
        self._before = self.row
        self._lift_tools, self.lift_normal = stand.tools, np.asarray(stand.lift_normal, dtype=float)
        self.clear = stand.clear
        """The tools are off the sheet."""
        self.tools = Tools(stand.tools.forming, with_support=both_tools)
        self.forces: tuple[float, ...] = (0.0,) * 6
        self.targets = self.row[:6]
        """(6,) m, tips that were commanded for the present tick, offsets included."""
        self.time = 0.0
        """s, of the present tick."""
        self.code, self.message = ErrorCode.OK, ""
        self.ended = False
        self.phase, self.progress = "starting", 0.0
        self._program: Program = self._whole()
        self._leaving = False

    # -- what the controller calls ---------------------------------------------------------------

    @property
    def stand(self) -> Stand:
        """As in the protocol."""
        return Stand(self.tools, self.lift_normal, self.clear)

    def step(self, time: float, targets: Targets, forces: tuple[float, ...]) -> Row:
        """As in the protocol."""
        self.time, self.targets, self.forces = time, [*targets.tip_1, *targets.tip_2], forces
        present = self.row
        try:
            if not self._leaving:
                self.watch()
            self.row = next(self._program)
        except IsfError as error:
            self._retreat(error.code, error.message, stay=False)
            self.row = next(self._program, self.row)
        except StopIteration:
            self.ended = True
        self._before = present
        return self.row

    def add_measured(self, tool: int, time: float, tip: Sequence[float]) -> None:  # noqa: B027 - few probes want it
        """The machine has reported the ``tip`` (3,) m of ``tool`` (1, 2) at ``time`` s."""

    def give_up(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        """End early: after an operator's stop at rest where the tools are, else lifted clear and parked.

        The lift is a plain sequence of positions: it does not need the load cells, which may be the reason.
        """
        self._retreat(code, text, stay=stay and code is ErrorCode.STOPPED)

    # -- for programs ----------------------------------------------------------------------------

    @abstractmethod
    def program(self) -> Program:
        """Rows of the measurement, from tools that are lifted clear, to anywhere."""

    @abstractmethod
    def watch(self) -> None:
        """Called every tick; raises IsfError when the measurement must end."""

    def here(self) -> Posture:
        """Where the tools are commanded to be, offsets left out."""
        return posture_of(self.row)

    def follow(self, motions: list[Motion]) -> Program:
        """Rows of moves, one after the other."""
        for motion in motions:
            for row in rows_of(motion)[1:]:  # the first one is where the tools are
                row[Column.SET_POINT] = row[Column.COORDINATE] = float("nan")
                row[Column.HOLDER] = self.row[Column.HOLDER]
                yield row

    def rest(self, time: float, each_tick: Callable[[], None] | None = None) -> Program:
        """Stand still for ``time`` s; ``each_tick`` is called with the forces of every tick."""
        for _ in range(max(1, round(time * self.config.rate))):
            yield self.row
            if each_tick is not None:
                each_tick()

    def glide(
        self, way_1: Array, way_2: Array, length: float, speed: float, enough: Callable[[], bool] | None = None
    ) -> Program:
        """Move tool 1 along ``way_1`` and tool 2 along ``way_2`` (3,) by up to ``length`` m, until ``enough()``."""
        start = list(self.row)
        glide = Glide(length, speed, ACCELERATION, self.config.rate)
        while length > 0.0:
            moved = glide.step()
            row = list(start)
            for k in range(3):
                row[Column.TIP_1 + k] += moved * float(way_1[k])
                row[Column.TIP_2 + k] += moved * float(way_2[k])
            yield row
            if glide.at_rest:
                return
            if enough is not None and enough():
                glide.stop()
                enough = None

    # -- inside ----------------------------------------------------------------------------------

    def _whole(self) -> Program:
        yield from self.away()
        yield from self.program()
        self._leaving = True
        yield from self.away()

    def away(self) -> Program:
        """Lift the tools clear of the sheet, and park them."""
        config, here = self.config, self.here()
        self.phase = "lifting the tools"
        if self.clear:
            height = config.park_height
            one = np.array([*here.tip_1[:2], height]) if self.tools.moves(1) else here.tip_1
            two = np.array([*here.tip_2[:2], -height]) if self.tools.moves(2) else here.tip_2
            high = Posture(one, two, here.angle, here.holder, here.axis)
            if max(np.abs(high.tip_1 - here.tip_1).max(), np.abs(high.tip_2 - here.tip_2).max()) > 1e-9:
                yield from self.follow([tool_moves.move(config, here, high, config.rapid_speed)])
        else:
            yield from self.follow(tool_moves.lift(config, here, self.lift_normal, self._lift_tools))
            self.clear = True
        self._lift_tools = self.tools
        yield from self.follow(tool_moves.park(config, self.here(), self.tools))

    def _retreat(self, code: ErrorCode, text: str, *, stay: bool) -> None:
        if self.code is ErrorCode.OK:
            self.code, self.message = code, text
            self._leaving = True
            self._program = self._leave(self._velocity(), stay=stay)
        elif stay:
            self._program = self._leave(self._velocity(), stay=True)

    def _velocity(self) -> Array:
        """(6,) m/s of both tips."""
        return self.config.rate * (np.array(self.row[:6]) - np.array(self._before[:6]))

    def _leave(self, velocity: Array, *, stay: bool) -> Program:
        """Brake straight on from ``velocity`` (6,) m/s, then lift and park unless the tools ``stay``."""
        if np.abs(velocity).max() > 1e-9:
            self.phase = "stopping"
            yield from self.follow([tool_moves.brake(self.config, self.here(), (velocity[:3], velocity[3:]))])
        if not stay:
            yield from self.away()
        elif self.clear:
            # who stays over (or under) the sheet is lifted before anything else; at park height there is no need
            heights = min(self.row[Column.TIP_1 + 2], -self.row[Column.TIP_2 + 2])
            self.clear = heights > self.config.park_height - self.config.clearance


_BRAKING = 0.8
"""Share of the acceleration that braking is planned with: it begins one tick late."""


class Glide:
    """Position along a way of ``length`` m at no more than ``speed`` m/s; one call per tick of ``rate`` Hz.

    :attr:`speed` may be changed on the way.
    """

    def __init__(self, length: float, speed: float, acceleration: float, rate: float) -> None:
        self._length, self.speed = length, speed
        self._step, self._period = acceleration / rate, 1.0 / rate
        self._braking = 2.0 * _BRAKING * acceleration
        self._velocity = 0.0
        self._stopping = False
        self.position = 0.0
        """m from the begin."""

    @property
    def at_rest(self) -> bool:
        """True at the end of the way, and once it was stopped."""
        return self.position >= self._length or (self._stopping and self._velocity <= 0.0)

    def stop(self) -> None:
        """Come to rest as soon as possible."""
        self._stopping = True

    def step(self) -> float:
        """m, position after one tick."""
        left = self._length - self.position
        wanted = 0.0 if self._stopping else min(self.speed, math.sqrt(self._braking * max(left, 0.0)))
        change = min(max(wanted - self._velocity, -self._step), self._step)
        self._velocity = max(0.0, self._velocity + change)
        if not self._stopping and self._velocity <= 0.0:
            self._velocity = self._step
        moved = self._velocity * self._period
        # the last tick goes to the very end: returning must not leave a rest
        self.position = self._length if moved >= left - 1e-9 else self.position + moved
        return self.position
