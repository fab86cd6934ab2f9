"""The tree of a forming cell from its rig file and job.

``base`` - ``table`` - ``clamp`` - ``sheet``, and below the sheet a chain of axes for each tool that ends in its tip,
``tool_k``; ``tool_k_cell`` is the origin of its load cell. Sizes that no file holds are assumed: they matter to the
picture and to masses, not to frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from isf_core.files.job import METRES, Job, JobFile
from isf_core.files.rig import Rig, ToolAxis
from isf_core.files.tooling import ToolSpec

from isf_description import arm, hexapod
from isf_description.axes import linear_axis
from isf_description.tree import Body, Description, Joint, Limits, Link

SHEET = "sheet"

HOLDER = "blank_holder"
"""Joint that lowers clamp and sheet onto a die, m (TPIF)."""

RADIUS, STICK_OUT, THICKNESS = 5e-3, 80e-3, 1e-3
"""m; of tools and of the blank where no job tells."""

STRIP, PLATE = 50e-3, 25e-3
"""m; width of the clamping frame around the free sheet, thickness of its lower half."""

HOLDER_TRAVEL = 0.2
"""m; how far a blank holder may come down."""


@dataclass(frozen=True)
class Tool:
    """One tool as it is drawn, all in m from its tip along its axis.

    Attributes
    ----------
    number : 1 above the sheet, 2 below it
    radius, corner : of the tip; equal for a hemisphere
    shank : radius ; stick_out : where the spindle begins
    cell : origin of the load cell ; spindle_end : where the axis that carries it begins
    """

    number: int
    radius: float
    corner: float
    shank: float
    stick_out: float
    cell: float

    @property
    def up(self) -> float:
        """1: the tool is above its tip, -1: below it."""
        return 1.0 if self.number == 1 else -1.0

    @property
    def spindle_end(self) -> float:
        """m, where the ram begins."""
        return max(self.cell, self.stick_out) + 20e-3

    @staticmethod
    def of(number: int, spec: ToolSpec | None, rig: Rig) -> Tool:
        """From the job's tool, where there is a job, and the rig's axes."""
        axes = rig.tool_1 if number == 1 else rig.tool_2
        cell = _cell_distance(axes, rig)
        given = None if spec is None else spec.stick_out
        stick_out = given if given is not None else min(STICK_OUT, 0.7 * cell) if cell else STICK_OUT
        radius = RADIUS if spec is None else spec.radius
        return Tool(
            number,
            radius,
            radius if spec is None else spec.ball_radius,
            radius if spec is None or spec.shank_radius is None else spec.shank_radius,
            stick_out,
            cell or stick_out + 40e-3,
        )


def describe(rig: Rig, job_file: JobFile | None = None) -> Description:
    """The cell of a rig; with a job its tools, blank and die, else both tools of the rig and a blank of 1 mm."""
    job = None if job_file is None else job_file.job
    tools = [Tool.of(1, None if job is None else job.tool_1, rig)]
    if job is None or job.tool_2 is not None:
        tools.append(Tool.of(2, None if job is None else job.tool_2, rig))
    links, joints = _stand(rig, job, job_file, tools)
    for tool in tools:
        if tool.number == 1 and rig.kinematics == "hexapod_spif_a":
            more_links, more_joints = hexapod.chain(rig, SHEET, tool.corner)
        elif rig.arm(tool.number) is not None:
            more_links, more_joints = arm.chain(rig, tool.number, SHEET)
        else:
            more_links, more_joints = _gantry(rig, tool)
        links += [*more_links, *_tool_links(rig, tool)]
        joints += [*more_joints, *_tool_joints(rig, tool)]
    return Description(rig.name if job is None else f"{rig.name}_{job.name}", tuple(links), tuple(joints))


def ball_radius(job_file: JobFile | None, number: int) -> float:
    """m, of the ball of tool ``number``, or of the rounded edge of a flat tip; assumed without a job that has it."""
    specs = () if job_file is None else (job_file.job.tool_1, job_file.job.tool_2)
    spec = specs[number - 1] if specs else None
    return RADIUS if spec is None else spec.ball_radius


def tip_frame(rig: Rig, number: int) -> str:
    """Frame at the tip of tool ``number`` with the axes of the sheet: what a wrench is shown in."""
    hangs = number == 1 and rig.kinematics == "hexapod_spif_a"
    return hexapod.UPRIGHT if hangs else f"tool_{number}"


def _cell_distance(axes: ToolAxis, rig: Rig) -> float:
    """m, from the tip to the load cell; 0: no file tells."""
    return rig.load_cell.tip_distance if axes.spindle_cells is None else axes.spindle_cells.height


def _stand(rig: Rig, job: Job | None, job_file: JobFile | None, tools: list[Tool]) -> tuple[list[Link], list[Joint]]:
    """What does not move but for the blank holder: table, clamp, sheet, die."""
    half = (0.5 * rig.clamp.size[0] + STRIP, 0.5 * rig.clamp.size[1] + STRIP)
    thickness = THICKNESS if job is None else job.sheet.thickness
    lower = next((tool for tool in tools if tool.number == 2), None)
    below = None if rig.tool_1.arm is None else rig.tool_1.arm.table
    floor = below or 0.4 if lower is None else _reach(rig, lower) + 2.0 * rig.limits.travel[2] + 0.1
    table = [Body("box", (2 * half[0] + 0.7, 2 * half[1] + 0.7, 0.06), "table", (0, 0, -0.03), 0.5)]
    if job is None or job.process != "TPIF":  # on the holder's columns it would have to slide
        height = floor - PLATE - thickness
        table += [
            Body("cylinder", (20e-3, height), "frame", (x, y, 0.5 * height))
            for x in (-half[0], half[0])
            for y in (-half[1], half[1])
        ]
    for tool in tools:
        if tool.number == 1 and rig.kinematics == "hexapod_spif_a":
            table += hexapod.columns(rig, floor)
        elif rig.arm(tool.number) is None:
            table += _rails(rig, tool, floor)
    upper = rig.clamp.height
    clamp = [*_ring(rig.clamp.size, PLATE, -0.5 * PLATE)]
    if upper > 0.0:
        clamp += _ring(rig.clamp.size, upper, thickness + 0.5 * upper)
    if job is not None and job.backing_plate is not None and job.backing_plate.shape == "rectangle":
        clamp += _plate(rig.clamp.size, job.backing_plate.extent)
    links = [Link("base"), Link("table", tuple(table)), Link("clamp", tuple(clamp)), Link(SHEET)]
    joints = [Joint("table_fixed", "base", "table"), _holder(rig, job, floor - thickness)]
    joints.append(Joint("sheet_fixed", "clamp", SHEET, place=(0.0, 0.0, thickness)))
    if job is not None and job_file is not None and job.die is not None:
        scale = METRES[job.die.unit]
        path = str((job_file.base / job.die.mesh).resolve())
        links.append(Link("die", (Body("mesh", (scale, scale, scale), "die", file=path),)))
        joints.append(Joint("die_fixed", "table", "die", place=(0.0, 0.0, floor)))
    return links, joints


def _holder(rig: Rig, job: Job | None, height: float) -> Joint:
    place = (0.0, 0.0, height)
    if job is None or job.process != "TPIF":
        return Joint("clamp_fixed", "table", "clamp", place=place)
    limits = Limits(-HOLDER_TRAVEL, 0.0, rig.limits.speed, rig.limits.force[2])
    return Joint(HOLDER, "table", "clamp", "prismatic", place, limits=limits)


def _ring(opening: tuple[float, float], thickness: float, height: float) -> list[Body]:
    """Four strips around an opening."""
    x, y = opening
    return [
        *(
            Body("box", (STRIP, y + 2 * STRIP, thickness), "clamp", (s * 0.5 * (x + STRIP), 0.0, height))
            for s in (-1, 1)
        ),
        *(Body("box", (x, STRIP, thickness), "clamp", (0.0, s * 0.5 * (y + STRIP), height)) for s in (-1, 1)),
    ]


def _plate(clamp: tuple[float, float], opening: tuple[float, float]) -> list[Body]:
    """A backing plate of 10 mm between clamp and opening."""
    dx, dy = 0.5 * (clamp[0] - opening[0]), 0.5 * (clamp[1] - opening[1])
    if min(dx, dy) <= 0.0:
        return []
    return [
        *(Body("box", (dx, clamp[1], 10e-3), "frame", (s * 0.5 * (opening[0] + dx), 0.0, -5e-3)) for s in (-1, 1)),
        *(Body("box", (opening[0], dy, 10e-3), "frame", (0.0, s * 0.5 * (opening[1] + dy), -5e-3)) for s in (-1, 1)),
    ]


BEAM, COLUMN, HEAD, OVERLAP = 0.1, 0.07, 0.14, 0.15
"""m; section of beams and rails, of columns, size of the carriage that holds a ram, length of ram that stays in it."""


def _reach(rig: Rig, tool: Tool) -> float:
    """m, from the sheet to the middle of the carriages of a gantry."""
    return rig.limits.travel[2] + tool.spindle_end + 0.5 * OVERLAP


def _span(rig: Rig) -> float:
    """m, from the middle to the rails at either side."""
    return max(0.5 * rig.clamp.size[1] + STRIP, rig.limits.travel[1] + HEAD) + BEAM


def _rails(rig: Rig, tool: Tool, floor: float) -> list[Body]:
    """Two rails along x with their columns; ``floor`` m is the table below the sheet."""
    height = floor + tool.up * _reach(rig, tool) - 0.5 * (HEAD + BEAM)
    half = max(0.5 * rig.clamp.size[0], rig.limits.travel[0]) + 0.25
    bodies = []
    for y in (-_span(rig), _span(rig)):
        bodies.append(Body("box", (2 * half, BEAM, BEAM), "frame", (0.0, y, height), 0.4))
        top = height - 0.5 * BEAM
        if top > 0.0:
            bodies += [
                Body("box", (COLUMN, COLUMN, top), "frame", (s * (half - 0.5 * COLUMN), y, 0.5 * top), 0.4)
                for s in (-1, 1)
            ]
    return bodies


def _gantry(rig: Rig, tool: Tool) -> tuple[list[Link], list[Joint]]:
    """Three axes; their positions are the coordinates of the tip in frame ``sheet``."""
    k, up, high = f"tool_{tool.number}", tool.up, _reach(rig, tool)
    span, travel = _span(rig), rig.limits.travel
    bridge = Body("box", (BEAM, 2 * span + BEAM, HEAD), "carriage", (-0.5 * (HEAD + BEAM), 0.0, 0.0), 0.3)
    head = Body("box", (HEAD, HEAD, HEAD), "carriage", fill=0.4)
    length = 2.0 * travel[2] + OVERLAP
    ram = Body("box", (0.08, 0.08, length), "ram", (0.0, 0.0, up * 0.5 * length), 0.5)
    links = [Link(f"{k}_bridge", (bridge,)), Link(f"{k}_carriage", (head,)), Link(f"{k}_ram", (ram,))]
    places = ((0.0, 0.0, up * high), (0.0, 0.0, 0.0), (0.0, 0.0, up * (tool.spindle_end - high)))
    parents = (SHEET, f"{k}_bridge", f"{k}_carriage")
    joints = [
        linear_axis(rig, k, axis, parents[axis], links[axis].name, places[axis])  # places add up to the tip
        for axis in range(3)
    ]
    joints.append(Joint(f"{k}_fixed", f"{k}_ram", k, place=(0.0, 0.0, -up * tool.spindle_end)))
    return links, joints


def _tool_links(rig: Rig, tool: Tool) -> list[Link]:
    """The tool itself, and its load cell or cells; an upright tool has the axes of the sheet."""
    k, up = f"tool_{tool.number}", tool.up

    def along(shape: float, first: float, last: float, colour: str) -> Body:
        return Body("cylinder", (shape, last - first), colour, (0.0, 0.0, up * 0.5 * (first + last)))

    bodies = []
    if tool.stick_out > tool.radius:  # else the ball sits in the spindle
        bodies.append(along(tool.shank, tool.radius, tool.stick_out, "tool"))
    if tool.corner == tool.radius:
        bodies.append(Body("sphere", (tool.radius,), "tool", (0.0, 0.0, up * tool.radius)))
    else:
        bodies.append(along(tool.radius - 0.3 * tool.corner, 0.0, tool.corner, "tool"))
        bodies.append(along(tool.radius, tool.corner, max(tool.radius, 2.0 * tool.corner), "tool"))
    if tool.spindle_end - tool.stick_out > 1e-3:
        bodies.append(along(max(30e-3, 1.5 * tool.shank), tool.stick_out, tool.spindle_end, "ram"))
    axes = rig.tool_1 if tool.number == 1 else rig.tool_2
    if axes.spindle_cells is None:
        cell = Link(f"{k}_cell", (Body("cylinder", (max(38e-3, 1.8 * tool.shank), 24e-3), "cell"),))
        return [Link(k, tuple(bodies)), cell]
    cells = [Link(f"{k}_cell_{n}", (Body("cylinder", (25e-3, 30e-3), "cell"),)) for n in (1, 2, 3)]
    return [Link(k, tuple(bodies)), Link(f"{k}_cell"), *cells]


def _tool_joints(rig: Rig, tool: Tool) -> list[Joint]:
    k = f"tool_{tool.number}"
    axes = rig.tool_1 if tool.number == 1 else rig.tool_2
    place = (0.0, 0.0, tool.up * tool.cell)
    if axes.spindle_cells is None:
        return [Joint(f"{k}_cell_fixed", k, f"{k}_cell", place=place)]
    cells = axes.spindle_cells
    joints = [Joint(f"{k}_cell_fixed", k, f"{k}_cell", place=place, turn=cells.rotation)]
    for n, angle in ((1, 0.0), (2, math.radians(120.0)), (3, math.radians(-120.0))):
        around = (cells.radius * math.cos(angle), cells.radius * math.sin(angle), 0.0)
        joints.append(Joint(f"{k}_cell_{n}_fixed", f"{k}_cell", f"{k}_cell_{n}", place=around))
    return joints
