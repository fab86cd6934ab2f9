"""Everything that is known of one formed part: the job, what was planned, corrected and measured, and the shape.

The in-process cell makes a record directly; :mod:`isf_analysis.bag.bag_reader` makes one from a bag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import yaml
from isf_core.contour import Contour, ContourCorrection, ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.events import Event, torn
from isf_core.files import yaml_file
from isf_core.files.job import Job, ToleranceSpec
from isf_core.geometry.height_map import HeightMap
from isf_core.simulated_sheet import SEALED_VARIANTS
from isf_core.thinned_sheet import ThinnedSheet
from isf_core.types import Array

from isf_analysis.measures.contour_scan import ContourScan

Vector = tuple[float, float, float]


def _same_path(one: Contour, other: Contour) -> bool:
    """True when both touch the sheet at the same points."""
    return np.array_equal(one.contact, other.contact)


@dataclass(frozen=True)
class PartRecord:
    """Record of one part; SI units, frame ``sheet``.

    Attributes
    ----------
    job_name, job_text : name and YAML text of the job
    plan_id : the plan that was formed
    process : SPIF, TPIF, DSIF or ADSIF
    correction : springback method in use ("none": nothing was corrected)
    support_force : N, set-point in use; 0 = position control
    variant, seed : of the simulated plant; variant -1 = a real machine
    control_rate : Hz
    lockstep : run in lockstep with a simulated machine
    software : version of the software that formed the part
    nominal, corrected, corrections, results : one element per contour that got so far, by index
    target : shape that was wanted, scan : shape that was measured in the clamp; None when not recorded
    ticks, late_ticks, lost_messages : counted by force control and machine together
    sim_time : s, time of the process; wall_time : s
    faults : (code, message) of every fault the machine latched
    scans : those made between contours, oldest first; empty too when none was recorded
    events : what happened to sheet or machine, oldest first; empty too when the machine tells none
    notes : remarks for people on how complete the record is
    sheet : ``model`` of the simulated sheet, and what it cost where it was formed in this process; empty: not known
    axis_error : m, root mean square and largest error of the axes while a tool touched the sheet; None: not told
    tool_compliance : m/N of tool 1 and of tool 2, each of the tip in x, y and z, as force control has it; None: unknown
    formed_sheet : thickness and strain margin of the simulated sheet at the end; None: of a real machine, or not told
    released : (P, 3) m, points of the part out of the clamp and trimmed, as it came to rest; None: not released, or not
        told
    base_folder : that relative paths in the job refer to; empty: not known
    plan_warnings : what the planner warned of; empty too when the record is older than this
    preforms : shapes that the stages before the last end with, on the grid of ``target``; empty too when the record is
        older than this
    """

    job_name: str
    job_text: str
    plan_id: str
    process: str
    correction: str
    support_force: float
    variant: int
    seed: int
    control_rate: float
    lockstep: bool
    software: str
    nominal: tuple[Contour, ...]
    corrected: tuple[Contour, ...]
    corrections: tuple[ContourCorrection, ...]
    results: tuple[ContourResult, ...]
    target: HeightMap | None
    scan: HeightMap | None
    ticks: int
    late_ticks: int
    lost_messages: int
    sim_time: float
    wall_time: float
    faults: tuple[tuple[int, str], ...] = ()
    notes: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    scans: tuple[ContourScan, ...] = ()
    sheet: Mapping[str, object] = field(default_factory=dict)
    base_folder: str = ""
    axis_error: tuple[float, float] | None = None
    tool_compliance: tuple[Vector, Vector] | None = None
    formed_sheet: ThinnedSheet | None = None
    released: Array | None = None
    plan_warnings: tuple[str, ...] = ()
    preforms: tuple[HeightMap, ...] = ()

    @property
    def planned(self) -> int:
        """Number of contours in the plan; 0 when no contour was recorded."""
        return self.nominal[0].count if self.nominal else 0

    @property
    def formed(self) -> int:
        """Number of contours of which every point was reached."""
        return sum(result.completed for result in self.results)

    @property
    def last_stage(self) -> tuple[Contour, ...]:
        """Contours as planned that made the shape what it is: all, or of a part formed in stages those of the last.

        Of a part that ended before its last stage did: those of the stage before, and in their place the formed ones
        of the last stage where that passes over the same path again.
        """
        last = max((contour.stage for contour in self.nominal), default=0)
        newest, before = (
            tuple(contour for contour in self.nominal if contour.stage == stage) for stage in (last, last - 1)
        )
        formed = {result.index for result in self.results if result.completed}
        if not before or not self.results or self.planned - 1 in formed:
            return newest
        again = tuple(contour for contour in newest if contour.index in formed)
        if all(_same_path(*pair) for pair in zip(again, before, strict=False)):
            return before[len(again) :] + again
        return before

    @property
    def sealed(self) -> bool:
        """True for a variant that is kept to publish results with."""
        return self.variant in SEALED_VARIANTS

    @property
    def plant(self) -> str:
        """The machine that formed it, for people; of a simulated one with its sheet."""
        if self.variant < 0:
            return "real machine"
        sheet = f", sheet: {self.sheet['model']}" if "model" in self.sheet else ""
        return f"simulated{sheet}, variant {self.variant}{' (sealed)' if self.sealed else ''}, seed {self.seed}"

    @property
    def corrects(self) -> bool:
        """True when a springback method was at work."""
        return self.correction not in ("", "none")

    def job(self) -> Job:
        """The job that was formed; its text may come from a bag, so that no file is opened by a path in it.

        Raises
        ------
        IsfError : of the text, naming line and field
        """
        return yaml_file.parse(self.job_text, Job, "job")

    @property
    def tolerance(self) -> ToleranceSpec:
        """What the part is judged by, from its job; the default where that has no such section that can be read."""
        return self._judged_by[0]

    @property
    def tolerance_note(self) -> str:
        """Why the default of :attr:`tolerance` stands for that of the job; empty: it does not."""
        return self._judged_by[1]

    @property
    def blank_thickness(self) -> float | None:
        """m, of the flat blank; None where the job cannot be read."""
        try:
            return self.job().sheet.thickness
        except IsfError:
            return None

    @cached_property
    def _judged_by(self) -> tuple[ToleranceSpec, str]:
        used = ToleranceSpec()
        try:
            job = yaml_file.content(self.job_text, "job")
            if not isinstance(job, Mapping) or "tolerance" not in job:
                return used, ""
            return yaml_file.parse(yaml.safe_dump(job["tolerance"]), ToleranceSpec, "tolerance"), ""
        except IsfError as error:
            why = error.what
        used_words = f"{1e3 * used.shape:g} mm, {100 * used.share:g} % are used"
        return used, f"tolerance of the job cannot be read: {why}; {used_words}"

    @property
    def warned(self) -> dict[int, str]:
        """What was said of contours that were formed all the same, by its code: the first, and how many more."""
        said: dict[int, list[str]] = {}
        for result in self.results:
            if result.completed and result.code:
                said.setdefault(result.code, []).append(f"{contour_label(result.index)}: {result.message}")
        return {
            code: first + (f"; so on {len(more)} more contour(s)" if more else "")
            for code, (first, *more) in said.items()
        }

    @property
    def overload(self) -> str:
        """That contours took more than the machine bears, for people; empty: none did."""
        return self.warned.get(int(ErrorCode.FORCE_LIMIT), "")

    def failure(self) -> tuple[int, str] | None:
        """Code and text of what ended the part early, or tore it; code 0 when unknown; None for a whole part."""
        if (lost := torn(self.events)) is not None:
            return int(lost.code), lost.message
        for result in self.results:
            if not result.completed:
                return int(result.code), f"{contour_label(result.index)}: {result.message or 'not completed'}"
        if self.faults:
            return self.faults[0]
        if self.formed < self.planned or not self.planned:
            return 0, f"{self.formed} of {self.planned} contours are recorded as formed; the cause is not recorded"
        return None
