"""The end of a run, and ``isf report``: read the bag, make the report, show the numbers, raise what failed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from isf_analysis.bag.bag_reader import read_bag, read_cell
from isf_analysis.bag.open_bag import bag_of
from isf_analysis.figures.cuts import Plane, planes_of
from isf_analysis.measures.record import PartRecord
from isf_analysis.report.page import write_report
from isf_analysis.report.shape_files import write_shape
from isf_core.contour import ContourResult, contour_label
from isf_core.errors import ErrorCode, IsfError, failure
from isf_core.events import torn
from isf_core.files.job import JobFile

from isf_cell.commands import terminal
from isf_cell.commands.exit_codes import ReportedError
from isf_cell.commands.resume import being_formed, how_to_go_on
from isf_cell.commands.run_folder import output_folder


def first_failure(results: Iterable[ContourResult]) -> IsfError | None:
    """The failure of the first contour that was not completed."""
    for result in results:
        if not result.completed:
            return failure(result.code, result.message, where=contour_label(result.index))
    return None


def finish(
    folder: Path,
    reference_bag: Path | None,
    *,
    failure: IsfError | None,
    as_json: bool,
    bag: Path | None = None,
    counts: Mapping[str, Any] | None = None,
    namespace: str | None = None,
    export: Path | None = None,
    sections: Sequence[Plane] = (),
) -> None:
    """Report the run in ``folder`` (its ``bag`` by default); raises ``failure`` after reporting it.

    A run of which its own bag does not hold the end has the failure BAG_INCOMPLETE.

    ``namespace`` is the cell of a bag, or reference, that holds several; ``sections`` are those that were asked for.
    ``counts`` replaces numbers that the bag
    cannot know, such as the wall time. The formed shape is written into the folder ``export`` once the report is
    written; where it cannot be, that is raised too and told in the JSON object, but not in summary.json: the part does
    not lack anything.
    """
    own = bag is None
    bag = bag or folder / "bag"
    try:
        record = read_bag(bag, namespace)
    except IsfError:
        if failure:  # the reason why there is nothing to report
            raise failure from None
        raise
    failure = failure or (torn(record.events) if own else None)
    if own and failure is None and (early := record.failure()) is not None:
        failure = IsfError(
            ErrorCode.BAG_INCOMPLETE,
            f"the record ends before the part does: {early[1]}",
            where=str(bag),
            advice="check the free space of the disk; what was recorded is reported",
        )
    reference = read_cell(reference_bag, namespace) if reference_bag else None
    made = write_report(record, folder, reference=reference, bag=bag, failure=failure, sections=sections)
    data = {**made.numbers, **(counts or {}), "bag": str(bag), "report": str(made.html)}
    data["machine"] = {**_machine_use(record), **made.numbers["machine"]}
    if failure:
        data["error"] = terminal.error_data(failure)
    (folder / "summary.json").write_text(json.dumps(terminal.without_nan(data), indent=2), encoding="utf-8")
    exported: tuple[Path, ...] = ()
    try:
        exported = write_shape(record, export) if export is not None else ()
    except IsfError as error:
        if failure is None:
            failure = error
            data["error"] = terminal.error_data(error)
    if as_json:
        terminal.print_json(data)
    terminal.show_summary(data, made.numbers.get("reference"))
    if not own:  # who formed the part was told before it began
        for text in record.plan_warnings:
            terminal.warn(f"the plan warned: {text}")
    terminal.say(f"report  {made.html}")
    for path in exported:
        terminal.say(f"shape   {path}")
    if failure:
        raise ReportedError(failure)


def _machine_use(record: PartRecord) -> dict[str, Any]:
    """What the plan asks of the machine; nothing where job or rig are not to be had any more."""
    try:
        job_file = JobFile(record.job_text, Path(record.base_folder or "."))
    except IsfError:
        return {}
    if job_file.rig.kinematics != "hexapod_spif_a":
        return {"kinematics": job_file.rig.kinematics}
    from isf_cell.commands.plan import machine_use  # late: the planner takes a second to load

    return machine_use(job_file.rig, record.nominal, job_file.job.tool_1.ball_radius)


def _check_no_program(export: Path) -> None:
    """Raise IsfError FILE_FIELD where ``export`` is named as a program, and not as the folder that it stands for."""
    from isf_planner.exports import FORMATS  # late: the planner takes a second to load

    if export.suffix.lower() in FORMATS.keys() - {".stl"} and not export.is_dir():
        raise IsfError(
            ErrorCode.FILE_FIELD,
            "is no folder, and the formed shape goes into one",
            where=f"--export {export}",
            advice=f"the program of the contours as they were formed: isf plan RUN --export {export.name}",
        )


def report_bag(
    bag: Path,
    reference: Path | None,
    output: Path | None,
    export: Path | None = None,
    sections: Sequence[str] = (),
    *,
    namespace: str | None = None,
    as_json: bool,
) -> None:
    """Report of ``bag`` (or of the run folder with it), of its cell ``namespace``; beside it, or in ``output``.

    ``sections`` that are drawn beside those of every report, such as ``y=12.5`` or ``30deg@10,-5`` (mm).

    The formed shape is written into the folder ``export``, the report first: it tells more of a part without a scan.

    Raises IsfError BAG_UNREADABLE, BAG_INCOMPLETE, FILE_FIELD, FILE_NOT_WRITABLE.
    """
    planes = planes_of(sections)
    if export is not None:
        _check_no_program(export)
    bag = bag_of(bag).resolve()
    reference = reference and bag_of(reference)
    try:
        with output_folder(output or bag.parent) as folder:
            finish(
                folder,
                reference,
                failure=None,
                as_json=as_json,
                bag=bag,
                namespace=namespace,
                export=export,
                sections=planes,
            )
    finally:
        if being_formed(bag.parent):
            terminal.say("the part is being formed: this is as far as it is")
        elif rest := how_to_go_on(bag.parent):
            terminal.say(rest)
