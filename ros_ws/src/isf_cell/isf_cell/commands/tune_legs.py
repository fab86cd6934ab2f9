"""``isf tune --legs``: step, ramp, circle and a contour of the job for both controllers of the legs, as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder

BAND = 50e-6
"""m, within which a leg has settled."""


def tune_legs(job: Path, output: Path | None, *, as_json: bool) -> None:
    """Try the position loops of the legs of the rig of ``job``.

    Raises IsfError as job file and planner do; FILE_FIELD for a rig without legs.
    """
    from isf_planner import plan  # late: the planner takes a second to load
    from isf_sim.legs import tuning
    from isf_sim.legs.figure import draw_legs

    job_file = load_job(job)
    rig = job_file.rig
    if rig.legs is None:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the rig {rig.name} has no legs",
            where=f"{job}: rig",
            advice="leave --legs out for the force loop, or take the rig torrao2013",
        )
    with terminal.part_progress(f"{job_file.job.name} (legs)") as progress:
        progress.phase("planning")
        contours = plan(job_file).contours
        contour = contours[len(contours) // 2]
        force = (0.0, 0.0, float(np.mean(contour.predicted_force)) if len(contour.predicted_force) else 0.0)
        rate, centre = job_file.job.control.rate, contour.forming_tip.mean(axis=0)
        radius = float(np.linalg.norm(contour.forming_tip[:, :2] - centre[:2], axis=1).mean())
        points = np.vstack([contour.forming_tip, contour.forming_tip[:1]]) if contour.closed else contour.forming_tip
        cases = (
            tuning.step_case(rate, centre),
            tuning.ramp_case(rate, centre),
            tuning.circle_case(rate, centre, radius, contour.feed, force),
            tuning.path_case(rate, points, contour.feed, force),
        )
        folder = make_run_folder(output, f"tune-legs-{job_file.job.name}")
        data: dict[str, Any] = {"controller": rig.legs.controller, "cases": {}, "pictures": []}
        for case in cases:
            progress.phase(case.text)
            responses = {
                name: tuning.respond(rig, case, rate, name, job_file.job.tool_1.radius) for name in tuning.CONTROLLERS
            }
            data["cases"][case.name] = {name: _numbers(case, response) for name, response in responses.items()}
            data["pictures"].append(str(draw_legs(case, responses, folder / f"legs_{case.name}.png")))
    if as_json:
        terminal.print_json(data)
    for case in cases:
        for name, found in data["cases"][case.name].items():
            terminal.console.print(f"{case.text}, {name}: {_words(found)}")
    terminal.say("pictures " + "\n         ".join(data["pictures"]))


def _numbers(case: Any, response: Any) -> dict[str, Any]:
    rms, largest = response.error(case.settled)
    found: dict[str, Any] = {
        "volts": float(np.abs(response.volts).max()),
        "lowest_pressure_bar": 1e-5 * float(response.pressure.min()),
        "stopped": bool(response.found),
    }
    if case.name == "step":
        return {"settling_s": response.settling(BAND), **found}
    return {
        "leg_error_um": {"rms": 1e6 * rms, "largest": 1e6 * largest},
        "speed_ripple": response.ripple(case.speed, case.settled),
        **found,
    }


def _words(found: dict[str, Any]) -> str:
    if found["stopped"]:
        return "the watch stopped it"
    if "settling_s" in found:
        return f"within {1e6 * BAND:.0f} µm after {found['settling_s']:.2f} s, at most {found['volts']:.1f} V"
    off = found["leg_error_um"]
    return (
        f"legs off by {off['rms']:.1f} µm rms, {off['largest']:.1f} µm at most; "
        f"speed of the tip within {100 * found['speed_ripple']:.1f} %"
    )
