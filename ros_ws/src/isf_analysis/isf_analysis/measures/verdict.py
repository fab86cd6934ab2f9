"""Whether a part is good, and what it falls short of: the one judgement of report, terminal and scripts.

A part is good when it is complete, enough of its shape was measured and is in the tolerance of its job, the support
tool (where there is one) kept the sheet, nothing happened that harms sheet or control, the machine bears the force, the
correction failed nowhere, and a simulated sheet was formed without inertia. A force out of its band is a remark: it
counts the noise of the load cell too. The tolerance of a job that names none is the accuracy published for closed-loop
parts: 90 % of the points within 0.3 mm (Lu 2016, section 4.4).

What the fast sheet says of a shape holds for that sheet: it yields under the tools alone, and comes back where a real
one has yielded around them. A part formed on it is therefore never called good without naming it.
"""

from __future__ import annotations

from typing import Any

from isf_analysis.measures.force_metrics import BAND
from isf_analysis.measures.percent import in_percent, percent

WITHIN_BAND = 0.99
"""Share of the time in full force control in which the force should be in its band (Ren 2018, 2.4: +-10 N; assumed)."""

CONTROLLED_CONTACT = 0.99
"""Share of the time in full force control in which the support tool must touch the sheet (assumed)."""

POSITIONED_CONTACT = 0.95
"""Share of the path on which it must do so under position control (assumed)."""

MEASURED = 0.9
"""Share of the part, of its wall and of its base that must be measured before a part is called good (assumed): below it
springback correction remarks on its scans, too. What was not measured may lie anywhere."""

MEASURED_REGIONS = {"wall_and_base": "wall and base", "wall": "the wall", "base": "the base"}
"""Regions of which that share must be measured, for people; a part may have no wall, or no base."""

MAXIMUM_REMARKS = 3
"""Remarks of the correction that are told; all are in the table of the report."""

FLATTERED = (
    "this sheet yields under the tools alone, a real one around them too, most where no plate backs it; "
    "before a real blank: isf simulate JOB --sheet shell_coarse, or isf tryout JOB"
)
"""What a shape on the fast sheet does not say."""

QUASI_STATIC = 0.02
"""Kinetic energy of the simulated sheet over its plastic work, up to which it counts as formed slowly (chosen)."""

NOT = "not corrected"

Numbers = dict[str, Any]


def verdict(numbers: Numbers) -> Numbers:
    """``good``, ``short_of``, and ``proviso`` under which it holds, from :mod:`isf_analysis.measures.summary`.

    ``short_of`` are sentences for people, ``proviso`` is one or empty: :data:`FLATTERED`.
    """
    proviso = FLATTERED if (numbers["sheet"] or {}).get("model") == "fast" else ""
    if not numbers["complete"]:
        return {"good": False, "short_of": [numbers["failure"]["message"]], "proviso": proviso}
    short_of = [*_inertia(numbers), *_contact(numbers), *_events(numbers), *_force(numbers), *_shape(numbers)]
    return {"good": not short_of, "short_of": short_of, "proviso": proviso}


def _shape(numbers: Numbers) -> list[str]:
    deviation, remarks = numbers["deviation"], numbers["remarks"]
    failed = [f"{NOT}: {item['text']}" for item in remarks if item["failed"]][:MAXIMUM_REMARKS]
    if deviation is None:
        return ["the shape was not measured", *failed]
    within = deviation["regions"]["wall_and_base"]["within_tolerance_fraction"]
    if within is None:
        return ["no point of the part was measured", *failed]
    unseen = _unseen(deviation)
    if within >= numbers["tolerance"]["share"]:
        return [*unseen, *failed]
    shape, share = numbers["tolerance"]["shape_mm"], numbers["tolerance"]["share"]
    reported = f"{in_percent(within, 1):g} % of the points are within {shape:g} mm, {100 * share:g} % are wanted"
    out = f"error out of tolerance: {reported}; largest {deviation['max_mm']:.2f} mm"
    told = [out, *unseen, *_floor(numbers)]
    if numbers["correction"] in ("", "none"):
        return [*told, "springback was not corrected"]
    return [
        *told,
        *(f"{NOT if item['failed'] else 'correction'}: {item['text']}" for item in remarks[:MAXIMUM_REMARKS]),
    ]


def _unseen(deviation: Numbers) -> list[str]:
    """That too little of the part was measured to call it good, with the shares of the regions that fall short."""
    known = {words: deviation["regions"][name]["coverage"] for name, words in MEASURED_REGIONS.items()}
    short = [
        f"{in_percent(share, 1):g} % of {words}"
        for words, share in known.items()
        if share is not None and share < MEASURED
    ]
    if not short:
        return []
    wanted = f"{100 * MEASURED:g} % of each region are wanted"
    return [f"not enough measured to call it good: the scan shows {', '.join(short)}; {wanted}"]


def _floor(numbers: Numbers) -> list[str]:
    """That no tool passed over a floor that is out of tolerance between walls that are in it: they leave a dome.

    Where the walls are out of it, too, the whole part lies too high or too deep, and passes would not help.
    """
    shape, share = numbers["tolerance"]["shape_mm"], numbers["tolerance"]["share"]
    regions = numbers["deviation"]["regions"]
    floor, wall = (regions[name]["within_tolerance_fraction"] for name in ("base", "wall"))
    if floor is None or wall is None or floor >= share or wall < share:
        return []
    if numbers["floor_passes"] or numbers["process"] not in ("SPIF", "DSIF"):
        return []
    if numbers["process"] == "SPIF" and numbers["correction"] not in ("", "none"):
        return []  # planned by itself where the floor is flat
    reported = f"{in_percent(floor, 1):g} % of its points are within {shape:g} mm"
    return [f"floor: {reported}, and no tool passed over it; path.floor_step plans that where it is flat"]


def in_tolerance(numbers: Numbers) -> bool:
    """Whether enough of the shape was measured, and that keeps the tolerance of the job."""
    deviation = numbers["deviation"]
    within = deviation and deviation["regions"]["wall_and_base"]["within_tolerance_fraction"]
    return within is not None and within >= numbers["tolerance"]["share"] and not _unseen(deviation)


def force_remarks(force: Numbers | None) -> list[str]:
    """That the support force is out of its band, for people: no part of the verdict."""
    within = None if force is None else force["within_10N_fraction"]
    if within is None or within >= WITHIN_BAND:
        return []
    limits = f"within {BAND:g} N of its set-point in {percent(within, 1)} of the controlled time"
    return [f"force out of band: the support force is {limits}, {100 * WITHIN_BAND:.0f} % are wanted"]


def _inertia(numbers: Numbers) -> list[str]:
    """That the simulated sheet was not formed slowly: what was measured of it is not that of a slow process."""
    kinetic = (numbers["sheet"] or {}).get("kinetic_over_plastic")
    if kinetic is None or kinetic <= QUASI_STATIC:
        return []
    return [
        "forces and shape carry inertia: the kinetic energy of the simulated sheet rose to "
        f"{percent(kinetic, 1)} of its plastic work, at most {100 * QUASI_STATIC:g} % are wanted; a finer --sheet "
        "moves its tools more slowly"
    ]


def _contact(numbers: Numbers) -> list[str]:
    losses, force = numbers["contact_losses"], numbers["force"]
    if losses is None:
        return []
    length, path = losses["length_mm"] or 0.0, losses["path_mm"] or 0.0
    where = f"no contact along {length:.0f} mm of {path:.0f} mm of the path"
    if force is not None and force["contact_fraction"] is not None:
        kept = force["contact_fraction"]
        if kept < CONTROLLED_CONTACT:
            return [f"contact lost: the support tool touched the sheet in {percent(kept, 1)} of the controlled time"]
    elif path and length > (1.0 - POSITIONED_CONTACT) * path:
        return [f"contact lost: the support tool is under position control and has {where}"]
    return []


def _events(numbers: Numbers) -> list[str]:
    harmful = [event for event in numbers["events"] if not event["harmless"]]
    return [f"{event['kind']}, {event['count']} times: {event['text']}" for event in harmful]


def _force(numbers: Numbers) -> list[str]:
    return [f"force: {numbers['overload']}"] if numbers["overload"] else []
