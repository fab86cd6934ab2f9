"""What a run may choose beyond its job file: correction method, support force, variant of the plant, seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import LARGEST_SUPPORT_FORCE, JobFile, correction_refusal, springback_method
from isf_core.simulated_sheet import SheetKind, default_sheet, scans_with_sensor

UNCORRECTED = "none"
"""Springback method of a part that is not corrected."""


@dataclass(frozen=True)
class RunOptions:
    """Overrides of one run.

    Attributes
    ----------
    correction : springback method, auto: the one that a job gets that names none; None: the job's
    support_force : N, set-point of the support tool; None: the job's
    variant : of the simulated plant, 0 = nominal; :mod:`isf_sim.variant`
    seed : seed of sensor noise and of the variant
    sheet : model that forms the simulated sheet; None: the default one of the job, :meth:`sheet_of`
    release : the finished part is taken out of the clamp, trimmed and scanned there, too

    Raises
    ------
    IsfError : FILE_FIELD, support force outside the bounds of the job field
    """

    correction: str | None = None
    support_force: float | None = None
    variant: int = 0
    seed: int = 0
    sheet: SheetKind | None = None
    release: bool = False

    def __post_init__(self) -> None:
        force = self.support_force
        if force is not None and not 0.0 <= force <= LARGEST_SUPPORT_FORCE:  # NaN neither
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"must be between 0 N and {LARGEST_SUPPORT_FORCE:g} N, is {force:g} N",
                where="--support-force",
                advice="0 is position control; without the option the job's set-point holds",
            )

    def check(self, job_file: JobFile) -> None:
        """Raise IsfError FILE_FIELD for what the job has no place for: a correction, a support force;
        SHEET_NOT_RELEASED where the part cannot be taken out of the clamp."""
        job, force = job_file.job, self.support_force
        if self.release and (job.process == "ADSIF" or self.sheet_of(job_file) == "fast"):
            raise IsfError(
                ErrorCode.SHEET_NOT_RELEASED,
                f"the sheet {'of accumulative forming' if job.process == 'ADSIF' else 'fast'} has no shape out of the "
                "clamp",
                where="--release",
                advice="leave it out, or form the part on --sheet shell_coarse, shell or shell_fine (not ADSIF)",
            )
        if refusal := correction_refusal(job.process, self.method(job_file)):
            raise IsfError(ErrorCode.FILE_FIELD, refusal, where="--correction", advice="leave it out, or use none")
        if job.accuracy_surfaces is not None and self.method(job_file) not in (UNCORRECTED, job.springback.method):
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"part.accuracy_surfaces was learned with springback method {job.springback.method}: what "
                f"{self.method(job_file)} corrects would be corrected twice",
                where="--correction",
                advice="leave it out, or leave part.accuracy_surfaces out of the job",
            )
        job.check_set_point(
            force, where="--support-force", advice="leave it out, or use a job of process DSIF with a support tool"
        )

    def scans_with_sensor(self, job_file: JobFile) -> bool:
        """Scans between contours are those of a scanner, in place of exact ones."""
        return scans_with_sensor(job_file.job, self.variant)

    def sheet_of(self, job_file: JobFile) -> SheetKind:
        """Simulated sheet of the run."""
        return self.sheet or default_sheet(job_file.job)

    def method(self, job_file: JobFile) -> str:
        """Springback method of the run."""
        return springback_method(job_file.job, self.correction)

    @property
    def named_at(self) -> str:
        """Where the springback method of the run is named, for errors."""
        return "--correction" if self.correction else "springback.method"

    def set_point(self, job_file: JobFile) -> float:
        """Support force of the run, N; 0 = position control. A chosen one (``auto``) is told for walls of 45 deg."""
        return job_file.job.support_force_at() if self.support_force is None else self.support_force

    def support_force_field(self) -> float:
        """The override as it goes into a message: NaN means the job's."""
        return math.nan if self.support_force is None else self.support_force
