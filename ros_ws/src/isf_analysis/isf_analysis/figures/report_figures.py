"""Which figures a report has, in their order, with the words below each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import Figure

from isf_analysis.figures import contact_figures, process_figures, scan_figures, shape_figures, style
from isf_analysis.figures.cuts import Cut, cuts
from isf_analysis.measures.contour_scan import ScanError
from isf_analysis.measures.deviation import Deviation, directions
from isf_analysis.measures.error_split import error_splits
from isf_analysis.measures.force_regions import path_forces
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.release import movement_of

SHAPE, CORRECTION, FORCE = "shape", "correction", "force"
"""Chapters of the report that figures belong to."""


@dataclass(frozen=True)
class Picture:
    """A finished figure: file name (without ending), chapter, title, caption and PNG file."""

    name: str
    chapter: str
    title: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class _Plan:
    name: str
    chapter: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def draw(
    record: PartRecord,
    deviation: Deviation | None,
    reference: PartRecord | None,
    reference_deviation: Deviation | None,
    progress: Callable[[str], None],
    scans: tuple[ScanError, ...] = (),
    asked: tuple[Cut, ...] = (),
) -> tuple[Picture, ...]:
    """All figures that the record has data for.

    ``scans``: errors after the scans between contours; ``asked``: sections beside those that show the part anyway.
    """
    pictures = []
    for plan in (
        *_shape(record, deviation, reference, reference_deviation, asked),
        *_scans(record, scans),
        *_process(record),
    ):
        progress(f"figure: {plan.title}")
        with style.applied():
            png = style.png(plan.draw())
        pictures.append(Picture(plan.name, plan.chapter, plan.title, plan.caption, png))
    return tuple(pictures)


def _shape(
    record: PartRecord,
    deviation: Deviation | None,
    reference: PartRecord | None,
    reference_deviation: Deviation | None,
    asked: tuple[Cut, ...],
) -> Iterator[_Plan]:
    target, scan = record.target, record.scan
    if deviation is None or target is None or scan is None:
        return
    limit = shape_figures.map_limit(deviation, reference_deviation)
    standing = directions(target)[1]
    colours = (
        "Red is too high, blue too low, white on target"
        if standing
        else "Red is too high (not formed deep enough), blue too deep, white on target"
    )
    if reference is not None and reference_deviation is not None and reference.target is not None:
        yield _Plan(
            "deviation_compare",
            SHAPE,
            "Uncorrected and this part",
            f"{colours}; both maps have the same scale. The thick line is the opening, thin lines are heights of the "
            "target, the circle marks the largest error.",
            partial(
                shape_figures.deviation_pair,
                reference_deviation,
                reference.target,
                deviation,
                target,
                limit,
                "this part",
            ),
        )
        own_limit = shape_figures.map_limit(deviation)
    else:
        own_limit = limit
    placed = [event for event in record.events if event.has_place]
    yield _Plan(
        "deviation_map",
        SHAPE,
        "Deviation of this part",
        f"{colours}. Measured minus wanted height, in the clamp, in the frame of the machine: nothing was aligned. The "
        f"scale ends at ± {own_limit:g} mm."
        + (" Marks: what the machine noticed there." if placed else "")
        + (" Dashed: the sections that were asked for." if asked else ""),
        partial(shape_figures.deviation_map, deviation, target, own_limit, placed, asked),
    )
    for cut in (*cuts(deviation), *asked):
        yield _Plan(
            cut.name,
            SHAPE,
            f"Section {cut.words}",
            "Profiles to scale, and below them the vertical distance from the target.",
            partial(shape_figures.section, cut, target, scan, reference.scan if reference is not None else None),
        )
    yield _Plan(
        "histogram",
        SHAPE,
        "How large the error is, and how often",
        "Vertical error of the points of the whole part, each by the same area in plan. Dotted lines: bands of 0.1, "
        "0.2 and 0.3 mm; dashed: the tolerance of the job.",
        partial(shape_figures.histogram, deviation, reference_deviation, record.tolerance.shape),
    )
    yield _Plan(
        "regions",
        SHAPE,
        "Error by region",
        "Vertical error; the regions are those of the target, see the end of this page.",
        partial(shape_figures.region_errors, deviation, reference_deviation),
    )
    splits = error_splits(record, deviation.error, movement_of(record))
    if splits:
        yield _Plan(
            "error_split",
            SHAPE,
            "Where the error comes from",
            "Terms of the error, mean of every contour, normal to the wanted surface; positive: not far enough. They "
            "add up to the error of the part in the clamp (Ren 2018, eq. 1-1); what it moves by when it is taken out, "
            "delta_3, is shown where it was measured.",
            partial(process_figures.error_split, splits),
        )


def _scans(record: PartRecord, scans: tuple[ScanError, ...]) -> Iterator[_Plan]:
    if not scans or record.target is None:
        return
    yield _Plan(
        "scan_errors",
        CORRECTION,
        "Error after each scan",
        "Vertical error of what was formed so far, to just above the contact of the last contour, as the scanner saw "
        "it, levelled on the sheet beside the clamp. What comes later still changes it.",
        partial(scan_figures.scan_curves, scans),
    )
    yield _Plan(
        "scan_maps",
        CORRECTION,
        "The part as it grew",
        "The same errors in plan; red is too high, blue too low, grey is not formed yet or was not seen.",
        partial(scan_figures.scan_maps, scans, record.target),
    )


def _process(record: PartRecord) -> Iterator[_Plan]:
    if record.corrects and record.corrections:
        yield _Plan(
            "corrections",
            CORRECTION,
            "Correction of every contour",
            "How far each contour was moved before it was formed, and the elastic recovery that was predicted for it."
            + (
                " Below: the error that the method foresees to remain, with its uncertainty."
                if process_figures.has_outlook(record)
                else ""
            ),
            partial(process_figures.corrections, record),
        )
    if process_figures.has_support_force(record):
        controlled = record.support_force > 0
        yield _Plan(
            "support_force",
            FORCE,
            "Support force",
            "Raw force of the load cell, horizontal and normal to the wall. "
            + (
                "Top: the whole part; middle: one contour, enlarged; bottom: error of every contour while the loop "
                "was in full control."
                if controlled
                else "The support tool was position controlled: where the force is zero it had lost contact."
            ),
            partial(process_figures.support_force, record),
        )
    paths = path_forces(record.results, record.corrected)
    if paths:
        yield _Plan(
            "contact",
            FORCE,
            "Contact along the path",
            "At the contour points. Top: where the support tool carried less than 5 N, from above. Bottom: every "
            "contour from its first to its last point"
            + (
                ", coloured by force less set-point; black: no contact, grey: no set-point."
                if record.support_force > 0
                else ", coloured by the force; black: no contact."
            ),
            partial(contact_figures.contact_map, paths),
        )
    if any(len(result.forming_force) for result in record.results):
        yield _Plan(
            "forming_force",
            FORCE,
            "Forming force",
            "Force of the sheet on the forming tool.",
            partial(process_figures.forming_force, record),
        )
