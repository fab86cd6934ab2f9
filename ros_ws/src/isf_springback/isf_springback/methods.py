"""Correction methods by name, found as entry points, so that a cell adds its own without touching this package.

A package registers a method in its ``setup.py``::

    entry_points={"isf.springback_methods": ["my_method = my_package.my_module:MyMethod"]}

where ``MyMethod`` is called with the job and derives from :class:`isf_springback.estimators.estimator.Estimator`. It is
loaded when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import AUTO, JobFile, correction_refusal, springback_method

from isf_springback.corrector import Corrector
from isf_springback.estimators.estimator import Estimator

GROUP = "isf.springback_methods"
"""Entry points of correction methods: callables that take the job (JobFile) and return an Estimator."""


@cache
def _entries() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def method_names() -> list[str]:
    """Names of all methods that are installed, sorted."""
    return sorted(_entries())


NAMED_AT = "springback.method"
"""Field of the job that names the method."""


def check_name(name: str, where: str = NAMED_AT) -> None:
    """Raise IsfError METHOD_UNKNOWN, with the names that exist, when there is no method ``name`` and it is not auto;
    ``where`` it was named."""
    if name not in _entries() and name != AUTO:
        raise IsfError(
            ErrorCode.METHOD_UNKNOWN,
            f"there is no springback method '{name}'",
            where=where,
            advice=f"known: {', '.join([AUTO, *method_names()])}",
        )


def check_method(name: str, job_file: JobFile, where: str = NAMED_AT) -> None:
    """Raise IsfError METHOD_UNKNOWN as :func:`check_name`, FILE_FIELD when the job's process cannot be corrected, or
    the job lacks the scans the method needs."""
    check_name(name, where)
    name = springback_method(job_file.job, name)
    if refusal := correction_refusal(job_file.job.process, name):
        raise IsfError(ErrorCode.FILE_FIELD, refusal, where="springback method", advice="form it with the method none")
    if needs_scans(name) and job_file.job.springback.scan_every == 0:
        raise IsfError(
            ErrorCode.FILE_FIELD,
            f"the method {name} corrects from scans, and the job makes none",
            where="springback.scan_every",
            advice="write 'scan_every: 1' in the section springback, or choose another method",
        )


def needs_scans(name: str) -> bool:
    """True when method ``name`` corrects from scans alone; raises IsfError METHOD_UNKNOWN."""
    check_name(name)
    return bool(getattr(_load(name), "needs_scans", False))


def make_corrector(name: str, job_file: JobFile) -> Corrector:
    """A corrector by method ``name``, for one part.

    Raises
    ------
    IsfError : as :func:`check_method`; what the method itself refuses (LEARNING_UNUSABLE, ...)
    """
    check_method(name, job_file)
    name = springback_method(job_file.job, name)
    estimator = _load(name)(job_file)
    if not isinstance(estimator, Estimator):
        raise IsfError(
            ErrorCode.METHOD_UNKNOWN,
            f"the springback method '{name}' is a {type(estimator).__name__}",
            where=_entries()[name].value,
            advice="a method derives from isf_springback.estimators.estimator.Estimator",
        )
    return Corrector(estimator, job_file)


def _load(name: str) -> Callable[[JobFile], Estimator]:
    check_name(name)
    entry = _entries()[name]
    try:
        found: Callable[[JobFile], Estimator] = entry.load()
    except Exception as error:  # a method of another package may fail in any way while it is loaded
        raise IsfError(
            ErrorCode.METHOD_UNKNOWN,
            f"the springback method '{name}' cannot be loaded: {type(error).__name__}: {error}",
            where=entry.value,
            advice="repair or remove the package that registers it",
        ) from error
    return found
