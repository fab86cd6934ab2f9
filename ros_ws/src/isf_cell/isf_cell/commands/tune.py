"""``isf tune``: step, corner and ramp responses of a job's force loop, and its stability margin, as pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl import ControlConfig

from isf_cell.commands import terminal
from isf_cell.commands.run_folder import make_run_folder


def tune_job(
    job: Path,
    output: Path | None,
    *,
    stiffness: float | None,
    delay: float,
    noise: float,
    loop_gain: float | None,
    as_json: bool,
) -> None:
    """Try the force loop of ``job``; ``stiffness`` N/um of the contact, ``delay`` ms, ``noise`` %, gain 1/s.

    Raises IsfError as the job file does, and for numbers that make no sense.
    """
    from isf_identify.figures import draw_margin, draw_responses
    from isf_identify.tuning import Plant, corner_case, gain_margin, ramp_case, respond, step_case

    job_file = load_job(job)
    config = ControlConfig.from_job(job_file)
    if loop_gain is not None:
        config = replace(config, loop_gain=loop_gain)
    contact = config.contact_stiffness if stiffness is None else stiffness * 1e6
    numbers = (contact, config.loop_gain, delay, noise)
    if not all(map(math.isfinite, numbers)) or min(contact, config.loop_gain) <= 0.0 or min(delay, noise) < 0.0:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "stiffness and gain must be finite and positive, delay and noise finite and not negative",
            where="isf tune",
            advice="leave --stiffness and --gain out for those of the rig and the controller",
        )
    plant = Plant(contact, delay * 1e-3, noise * 1e-2)
    margin = gain_margin(config, contact, plant.delay)
    step, corner, ramp = (respond(config, plant, case) for case in (step_case(), corner_case(), ramp_case()))
    folder = make_run_folder(output, f"tune-{job_file.job.name}")
    pictures = [
        draw_responses(config, plant, folder / "responses.png"),
        draw_margin(config, folder / "margin.png"),
    ]
    data: dict[str, Any] = {
        "loop_gain_per_s": config.loop_gain,
        "contact_stiffness_N_per_um": contact * 1e-6,
        "gain_margin": margin,
        "step_settling_s": step.settling(),
        "step_overshoot_N": step.overshoot(),
        "corner_largest_error_N": corner.largest_error(),
        "ramp_largest_error_N": ramp.largest_error(),
        "backoffs": step.backoffs + corner.backoffs + ramp.backoffs,
        "pictures": [str(picture) for picture in pictures],
    }
    if as_json:
        terminal.print_json(data)
    terminal.console.print(
        f"gain margin {margin:.1f}; step of 100 N settles in {1e3 * step.settling():.0f} ms, "
        f"{step.overshoot():.0f} N overshoot; largest error {corner.largest_error():.0f} N at a corner of 60 um, "
        f"{ramp.largest_error():.0f} N on a ramp of 300 um/s"
    )
    if margin < 1.5:
        terminal.warn("a margin below 1.5 is refused by force control: lower the gain")
    terminal.say("pictures " + "\n         ".join(data["pictures"]))
