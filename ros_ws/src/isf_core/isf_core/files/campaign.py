"""Campaign files: which jobs are formed by which methods, on which variants of the plant and which sheets."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator, model_validator

from isf_core.errors import IsfError
from isf_core.files import yaml_file
from isf_core.files.job import JobFile
from isf_core.files.yaml_file import FileModel
from isf_core.simulated_sheet import LARGEST_NUMBER, SheetKind

MOST_VARIANTS = 10_000
"""In one list: more are a slip of the pen."""


class MethodSpec(FileModel):
    """A way of forming: the job with some of its fields changed. A word alone is the springback method of that name."""

    name: str = Field(min_length=1, max_length=60)
    """As it stands in tables."""
    change: dict[str, Any] = Field(default_factory=dict)
    """Fields in place of those of the job, section by section as in a job file, null for one
    that is left out; none: the job as it is."""

    @model_validator(mode="before")
    @classmethod
    def _word(cls, data: Any) -> Any:
        return {"name": data, "change": {"springback": {"method": data}}} if isinstance(data, str) else data


class Campaign(FileModel):
    """Every job with every method, on every variant and every sheet."""

    name: str = Field(pattern=r"^[A-Za-z0-9][\w.-]{0,59}$")
    """Letters, digits, ``_``, ``.`` and ``-``: also the name of its folder."""
    jobs: tuple[str, ...] = Field(min_length=1)
    """Job files, relative to the campaign file."""
    methods: tuple[MethodSpec, ...] = Field(min_length=1)
    """Springback methods by name, or ``{name: ..., change: {...}}`` for a job with other fields changed."""
    variants: tuple[int, ...] = Field(default=(0,), min_length=1)
    """Of the simulated plant: numbers and ranges such as ``[0, 1-20]``."""
    sheets: tuple[SheetKind, ...] | None = Field(default=None, min_length=1)
    """Models of the simulated sheet: fast, shell_coarse, shell, shell_fine; none: the one that each job is formed on
    where nobody names one."""
    seed: int = Field(default=0, ge=0, le=LARGEST_NUMBER)
    """Of sensor noise and variants."""

    @field_validator("variants", mode="before")
    @classmethod
    def _ranges(cls, data: Any) -> Any:
        return variant_numbers(data if isinstance(data, list) else [data])

    @model_validator(mode="after")
    def _once(self) -> Campaign:
        names = {"jobs": self.jobs, "methods": tuple(spec.name for spec in self.methods), "sheets": self.sheets or ()}
        for field, values in names.items():
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise yaml_file.FieldError(f"'{twice}' stands there twice", field=field, advice="name each once")
        return self


def variant_numbers(items: Iterable[Any]) -> tuple[int, ...]:
    """Numbers of variants from numbers and texts such as ``0``, ``1-20`` or ``3,5``; each once, in their order.

    Raises
    ------
    ValueError : something else, or more than :data:`MOST_VARIANTS`
    """
    found: dict[int, None] = {}
    for item in items:
        for part in str(item).split(","):
            first, dash, last = (text.strip() for text in part.partition("-"))
            ends = (first, last if dash else first)
            if isinstance(item, bool) or not all(text.isdecimal() and int(text) <= LARGEST_NUMBER for text in ends):
                raise ValueError(f"'{item}' is no variant: write numbers and ranges such as 0, 1-20")
            low, high = map(int, ends)
            if not low <= high < low + MOST_VARIANTS:
                raise ValueError(f"'{part.strip()}' is no range of 1 to {MOST_VARIANTS} variants")
            found.update(dict.fromkeys(range(low, high + 1)))
    return tuple(found)


class CampaignFile:
    """A campaign and where it was read.

    Attributes
    ----------
    campaign : Campaign ; text : the file as read ; path : of the file
    """

    def __init__(self, path: Path) -> None:
        self.path, self.text = path, yaml_file.read(path)
        self.campaign: Campaign = yaml_file.parse(self.text, Campaign, str(path))

    def job(self, number: int, method: MethodSpec | None = None) -> JobFile:
        """Job ``number`` (from 0), with the changes of ``method``.

        Raises
        ------
        IsfError : as of the job file; what comes of the changes is told at the method
        """
        path = (self.path.resolve().parent / self.campaign.jobs[number]).resolve()
        text = yaml_file.read(path)
        plain = JobFile(text, path.parent, str(path))
        if method is None or not method.change:
            return plain
        try:
            return plain.changed(method.change, str(path))
        except IsfError as error:
            where = f"{self.path}: method {method.name} with {self.campaign.jobs[number]}"
            raise IsfError(error.code, error.what, where=where, advice=error.advice) from error
