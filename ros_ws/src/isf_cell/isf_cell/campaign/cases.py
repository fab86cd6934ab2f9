"""The cases of a campaign: every job with every method on every variant and sheet, each named by its content."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from isf_analysis.measures.campaign_row import CampaignRow, measured
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import MM
from isf_core import __version__
from isf_core.errors import IsfError, coded
from isf_core.files.campaign import CampaignFile
from isf_core.files.job import JobFile
from isf_core.simulated_sheet import default_sheet, sheet_kind
from isf_planner.predict.tool_marks import surface_of, tool_marks
from isf_springback.methods import check_method, check_name

from isf_cell import in_process
from isf_cell.campaign.content import job_content
from isf_cell.options import RunOptions


@dataclass(frozen=True)
class Case:
    """One part to form.

    Attributes
    ----------
    row : its row before it is formed; with a code where job and method do not go together
    text, base : of its job file, with the changes of its method
    """

    row: CampaignRow
    text: str
    base: Path

    @property
    def job_file(self) -> JobFile:
        """Its job; it was read before."""
        return JobFile(self.text, self.base, self.row.job)

    @property
    def title(self) -> str:
        """For people."""
        sheet = "" if self.row.sheet == "fast" else f", {self.row.sheet}"
        return f"{self.row.job}, {self.row.method}, variant {self.row.variant}{sheet}"


def cases_of(file: CampaignFile, sources: str) -> list[Case]:
    """Cases in the order of their use: variant after variant, so that a campaign that is stopped holds whole variants.

    Raises
    ------
    IsfError : a job that cannot be used, a method that does not exist, or that no job of the campaign can have
    """
    campaign = file.campaign
    names = _names(campaign.jobs)
    plain = [file.job(number) for number in range(len(names))]
    jobs: dict[tuple[int, str], tuple[JobFile, IsfError | None]] = {}
    for method in campaign.methods:
        refusals = []
        for number, job in enumerate(plain):
            try:
                changed = file.job(number, method)
                check_name(changed.job.springback.method)
                check_method(changed.job.springback.method, changed)
                jobs[number, method.name] = changed, None
            except IsfError as error:
                jobs[number, method.name] = job, error
                refusals.append(error)
        if len(refusals) == len(plain):
            first = refusals[0]
            where = first.where if str(file.path) in first.where else f"{file.path}: method {method.name}"
            raise IsfError(first.code, first.what, where=where, advice=first.advice)
    found = []
    for variant in campaign.variants:
        for named in campaign.sheets or (None,):
            for (number, name), (job_file, refusal) in sorted(jobs.items(), key=lambda item: item[0][0]):
                sheet = named or default_sheet(job_file.job)
                content = f"{job_content(job_file)} {sources} {variant} {campaign.seed} {sheet}"
                row = CampaignRow(
                    job=names[number],
                    method=name,
                    variant=variant,
                    seed=campaign.seed,
                    sheet=sheet,
                    key=hashlib.sha256(content.encode()).hexdigest()[:16],
                    sources=sources,
                    software=__version__,
                    process=job_file.job.process,
                    control_rate_Hz=job_file.job.control.rate,
                    tolerance_mm=MM * job_file.job.tolerance.shape,
                    code=0 if refusal is None else int(refusal.code),
                    message="" if refusal is None else refusal.message,
                )
                found.append(Case(row, job_file.text, job_file.base))
    return found


def _names(jobs: tuple[str, ...]) -> list[str]:
    """Of the jobs in tables: those of their files, with the folder where two are called the same."""
    stems = [Path(job).stem for job in jobs]
    return [
        stem if stems.count(stem) == 1 else str(Path(job).with_suffix(""))
        for stem, job in zip(stems, jobs, strict=True)
    ]


def form_case(case: Case) -> dict[str, Any]:
    """Row of the part, formed in this process; what ends or refuses it is in the row."""
    started, used = time.perf_counter(), time.process_time()
    row = case.row
    try:
        job_file = case.job_file
        options = RunOptions(variant=row.variant, seed=row.seed, sheet=sheet_kind(row.sheet))
        options.check(job_file)
        record = in_process.form(job_file, options)
        data = measured(row, record) | _planned_marks(record, job_file)
    except Exception as fault:  # a row of its own, beside those of all others
        error = coded(fault)
        data = asdict(replace(row, code=int(error.code), message=error.message))
    wall, cpu = time.perf_counter() - started, time.process_time() - used
    return data | {"wall_s": round(wall, 2), "cpu_s": round(cpu, 2)}


def _planned_marks(record: PartRecord, job_file: JobFile) -> dict[str, float]:
    """Tool marks that the contours leave as they were planned; nothing where no pass lies beside another."""
    contours = record.nominal
    marks = surface_of(contours, tool_marks(contours, job_file.job)) if contours else None
    if marks is None:
        return {}
    return {"mark_spacing_mm": round(MM * marks.usual_spacing, 4), "scallop_um": round(1e6 * marks.usual_ridge, 3)}
