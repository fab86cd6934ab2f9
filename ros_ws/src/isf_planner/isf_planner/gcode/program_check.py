"""A program (G-code) held against a job, its rig and the set-up of its cell, as a plan is; nothing is formed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.files.tooling import ToolSpec

from isf_planner.gcode.program_plan import (
    check_job_tool,
    check_program,
    check_tools,
    check_work_offsets,
    holds_of,
    lines_of,
    program_plan,
)
from isf_planner.gcode.reader import Finding, Program, read_program
from isf_planner.gcode.set_up import SetUp
from isf_planner.part_plan import Plan


@dataclass(frozen=True)
class CheckedProgram:
    """What was found.

    Attributes
    ----------
    program : as it was read ; job_file : whose sheet, tools and rig it is for
    findings : what is at fault, by line ; plan : its contours, None when something is at fault
    """

    program: Program
    job_file: JobFile
    findings: list[Finding]
    plan: Plan | None

    @property
    def failure(self) -> IsfError | None:
        """The first thing that is at fault; None: it can be formed."""
        if self.program.unknown:
            first = self.program.unknown[0]
            return IsfError(
                ErrorCode.PROGRAM_WORD_UNKNOWN,
                f"{self.program.unknown_count} word(s) are not understood, the first is {first.word}",
                where=f"{self.program.name}:{first.line}",
                advice="nothing of such a program is formed; see the list of words in the manual",
            )
        return self.findings[0].error if self.findings else None

    def numbers(self) -> dict[str, Any]:
        """For ``isf gcode --json``, without what is drawn."""
        program, plan = self.program, self.plan
        rapid = self.job_file.rig.limits.speed
        data: dict[str, Any] = {
            "program": program.name,
            "feasible": not self.findings and not program.unknown,
            "unknown_words": [{"line": one.line, "word": one.word, "text": one.text} for one in program.unknown],
            "findings": [
                {
                    "line": one.line,
                    "code": one.error.code.value,
                    "name": one.error.code.name,
                    "message": one.error.message,
                }
                for one in self.findings
            ],
            "points": len(program),
            "path_m": program.path_length,
            "time_s": program.time(rapid) if len(program) else 0.0,
            "two_tools": program.two_tools,
            "work_systems": [f"G{system}" for system in sorted(program.systems)],
            "remarks": list(program.remarks),
            "rig": self.job_file.rig.name,
            "contours": 0,
            "warnings": [],
        }
        if plan is not None:
            data |= {
                "contours": len(plan.contours),
                "contour_lines": list(lines_of(program, plan).values()),
                "stops": [
                    {"line": hold.line, "after_contour": number, "lifted": hold.lifted}
                    for number, hold in holds_of(program).items()
                ],
                "forming_path_m": plan.path_length,
                "depth_mm": -1e3 * min(float(contour.forming_tip[:, 2].min()) for contour in plan.contours),
                "warnings": list(plan.warnings),
            }
        return data


def checked(program: Program, job_file: JobFile, set_up: SetUp, other: ToolSpec) -> CheckedProgram:
    """Hold a ``program`` that was read with ``set_up`` against ``job_file``; ``other`` are tools without a radius
    there."""
    program = program.with_ball(job_file.job.tool_1.ball_radius)
    findings = list(program.findings)
    offsets = {system: set_up.offset(system) for system in program.systems}
    findings += check_work_offsets(program, job_file.rig, offsets) + check_program(program, job_file.rig)
    tips = {number: tip for number, tool in set_up.tools.items() if (tip := tool.tip) is not None}
    findings += check_tools(program, tips, other) + check_job_tool(program, tips, job_file.job.tool_1)
    findings.sort(key=lambda finding: finding.line)
    plan = None
    if not findings and not program.unknown:
        try:
            plan = program_plan(program, job_file)
        except IsfError as error:  # a fault of the sheet or the rig's limits belongs to the whole program
            findings.append(Finding(0, error))
    return CheckedProgram(program, job_file, findings, plan)


def check_program_text(text: str, name: str, job_file: JobFile, set_up: SetUp | None) -> CheckedProgram:
    """Read and check ``text`` for the sheet and tools of ``job_file``; raises IsfError of a text that is no program."""
    values = set_up or SetUp()
    program = read_program(text, values, name=name)
    return checked(program, job_file, values, job_file.job.tool_1)
