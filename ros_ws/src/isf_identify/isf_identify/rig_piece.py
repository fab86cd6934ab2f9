"""Results of an identification as a rig file: what is new, based on the rig that was in use (``based_on``)."""

from __future__ import annotations

import json

import numpy as np
from isf_core.files.job import JobFile
from isf_core.files.rig import Rig
from isf_core.files.yaml_file import find_named
from isf_core.types import Array

from isf_identify.fits import SignFit, StiffnessFit
from isf_identify.servo_probe import ServoFit, ServoProbe
from isf_identify.squeeze_probe import SqueezeProbe


def compliance_piece(
    rig: str,
    date: str,
    probe: SqueezeProbe,
    value: Array,
    deviation: Array,
    how: list[str],
    present: tuple[float, float, float],
) -> str:
    """``value``, ``deviation`` (3,) m/N; axes that were not observed (NaN) keep the ``present`` value of the rig."""
    tool = f"tool_{probe.settings.tool}"
    numbers = [value[k] if np.isfinite(value[k]) else present[k] for k in range(3)]
    text = ", ".join(f"{1e6 * number:.4f} um/N" for number in numbers)
    lines = [f"{tool}:", f"  compliance: [{text}]"]
    facts = {}
    for k, axis in enumerate("xyz"):
        known = np.isfinite(value[k])
        reported = f"{1e6 * value[k]:.4f} +- {1e6 * deviation[k]:.4f} um/N, {how[k]}" if known else f"kept; {how[k]}"
        facts[f"{tool}.compliance.{axis}"] = ("identified" if known else "not identified") + f" {date}: {reported}"
    facts[f"{tool}.compliance"] = _conditions(probe)
    return rig_piece(rig, lines, facts)


def stiffness_piece(rig: str, date: str, probe: SqueezeProbe, fit: StiffnessFit) -> str:
    """Contact stiffness as the force loop meets it."""
    angles = np.rad2deg(fit.wall_angle)
    fact = (
        f"identified {date}: {1e-6 * fit.value:.4f} +- {1e-6 * fit.deviation:.4f} N/um on walls of {angles.min():.0f} "
        f"to {angles.max():.0f} deg; {_conditions(probe)}"
    )
    return rig_piece(rig, [f"contact_stiffness: {1e-6 * fit.value:.4f} N/um"], {"contact_stiffness": fact})


def servo_piece(rig: str, date: str, probe: ServoProbe, fit: ServoFit) -> str:
    """Bandwidth of the position loop; the delay has no field of its own."""
    fact = (
        f"identified {date}: bandwidth {fit.bandwidth:.3f} +- {fit.bandwidth_deviation:.3f} Hz, delay "
        f"{1e3 * fit.delay:.2f} +- {1e3 * fit.delay_deviation:.2f} ms; chirp of tool_{probe.settings.tool} in free air"
    )
    return rig_piece(rig, ["servo:", f"  bandwidth: {fit.bandwidth:.3f} Hz"], {"servo.bandwidth": fact})


def signs_piece(rig: str, date: str, probe: SqueezeProbe, fit: SignFit, faults: list[str]) -> str:
    """Crosstalk of the cells; a cell with faults is mended in its driver, not in the rig file."""
    crosstalk = float(np.nanmax(fit.crosstalk))
    if faults or not np.isfinite(crosstalk):
        return "".join(f"# {fault}\n" for fault in faults)
    fact = f"identified {date}: largest share seen, signs and order right; {_conditions(probe)}"
    return rig_piece(rig, ["load_cell:", f"  crosstalk: {crosstalk:.4f}"], {"load_cell.crosstalk": fact})


def arm_part(rig: Rig, tool: int) -> Array:
    """(3,) m/N in x, y and z at the middle of the sheet: what the arm of ``tool`` (1, 2) takes; 0 without one.

    A rig file has the compliance of tool and holder alone; what is measured at the tip has that of the arm in it.
    """
    arm = rig.arm(tool)
    return np.zeros(3) if arm is None else np.diagonal(arm.compliance(arm.held(np.zeros(3))[0])).copy()


def rig_reference(job_file: JobFile) -> str:
    """What a piece for the rig of a job is based on: its name, or the absolute path of its file."""
    name = job_file.job.rig
    if not name.endswith((".yaml", ".yml")):
        return name
    return str(find_named("rigs", name, job_file.base).resolve())


def rig_piece(rig: str, lines: list[str], facts: dict[str, str]) -> str:
    """A rig file on top of ``rig``: ``lines`` of YAML, and ``facts`` per field as its provenance."""
    body = "".join(f"{line}\n" for line in lines)
    reported = "".join(f'  {name}: "{text}"\n' for name, text in facts.items())
    below = json.dumps(rig, ensure_ascii=False)  # a YAML string, whatever is in the path
    return f"based_on: {below}\n{body}provenance:\n{reported}"


def _conditions(probe: SqueezeProbe) -> str:
    places, settings = len(probe.places), probe.settings
    return (
        f"{places} places, {settings.repeats} times each, {len(probe.readings)} readings, forces to "
        f"{probe.largest:.0f} N, sheet of {1e3 * probe.geometry.thickness:g} mm, balls of "
        + " and ".join(f"{1e3 * radius:g} mm" for radius in probe.geometry.balls)
    )
