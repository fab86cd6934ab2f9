"""Accumulative DSIF: a planar spiral from the centre outwards, tools placed for the wall angle wanted at every point.

Both tools stay at constant height over one turn's width of fresh sheet; what has been formed is carried down as a
rigid body. The forming tip follows the level lines of the part projected into the plane, one pitch per turn;
position angle and gap come from the response surface inverted for the local wall angle (Ren 2018, chapter 3).
"""

from __future__ import annotations

import numpy as np
from isf_core.contour import Contour, Process
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import adsif_surface
from isf_core.files.adsif_surface import AdsifSurface
from isf_core.files.job import AdsifSpec, JobFile
from isf_core.process import thickness_and_tips
from isf_core.types import Array

from isf_planner.loops.sections import LoopTree
from isf_planner.part.mesh_checks import place_text
from isf_planner.part.meshes import Mesh
from isf_planner.paths import contour_making, joined_paths
from isf_planner.paths.contour_making import path_of
from isf_planner.paths.joined_paths import TipPath
from isf_planner.paths.loop_family import family
from isf_planner.surface.target_surface import TargetSurface

SMALLEST_FACET = 1e-10
"""m^2, doubled; the normal of a smaller facet says nothing about the wall."""

FLATTER = np.radians(1.0)
"""rad, by which a wall may be flatter than the response surface reaches before it is told."""


def surface_for(job_file: JobFile) -> AdsifSurface:
    """The response surface of a job, checked against its material, pitch and tools.

    Raises
    ------
    IsfError : ADSIF_SURFACE_MISMATCH, FILE_NOT_FOUND, FILE_FIELD, FEATURES_MIXED (flat tips)
    """
    job, spec = job_file.job, job_file.job.adsif or AdsifSpec()
    tools = [tool for tool in (job.tool_1, job.tool_2) if tool is not None]
    if any(tool.flat_radius > 0 for tool in tools):
        raise IsfError(
            ErrorCode.ADSIF_SURFACE_MISMATCH,
            "response surfaces hold for hemispherical tips",
            where="tool_1, tool_2",
            advice="leave corner_radius out",
        )
    surface = adsif_surface.load_surface(spec.surface, job_file.base)
    adsif_surface.check_use(
        surface, job_file.material.name, spec.pitch, job.sheet.thickness, tuple(tool.radius for tool in tools)
    )
    return surface


def check_reachable(mesh: Mesh, surface: AdsifSurface) -> None:
    """Refuse a wall that the surface does not reach, before anything is planned.

    Raises
    ------
    IsfError : ADSIF_NOT_REACHABLE, with the place
    """
    corners = mesh.corners()
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    angle = np.where(size > SMALLEST_FACET, np.arccos(np.clip(cross[:, 2] / np.maximum(size, 1e-30), -1.0, 1.0)), 0.0)
    worst = int(np.argmax(angle))
    # the surface is printed to 0.1 deg
    if np.degrees(angle[worst]) > np.degrees(surface.largest_angle) + 0.05:
        raise IsfError(
            ErrorCode.ADSIF_NOT_REACHABLE,
            f"the wall is {np.degrees(angle[worst]):.1f} deg steep, ADSIF with {surface.name} forms "
            f"{np.degrees(surface.largest_angle):.1f} deg at most",
            where=f"mesh at {place_text(corners[worst].mean(axis=0))}",
            advice="make the wall flatter, or form the part with process DSIF",
        )


def make_contours(
    tree: LoopTree, target: TargetSurface, job_file: JobFile, plan_id: str
) -> tuple[tuple[Contour, ...], tuple[str, ...]]:
    """Contours, one per turn from the inside out, and warnings.

    Parameters
    ----------
    tree : loops of the part for the forming ball, one pocket
    target : the sampled target

    Raises
    ------
    IsfError : FEATURES_MIXED for more than one pocket, ADSIF_NOT_REACHABLE, PATH_BROKEN
    """
    job, spec = job_file.job, job_file.job.adsif or AdsifSpec()
    surface = surface_for(job_file)
    if len(tree.features) != 1 or job.tool_2 is None:
        raise IsfError(
            ErrorCode.FEATURES_MIXED,
            f"ADSIF forms one pocket from its centre outwards, the part has {len(tree.features)} features",
            where="part",
            advice="form the part with process DSIF, or one pocket at a time",
        )
    paths = _spiral(tree, target, spec.pitch, job_file)
    projection = spec.projection_distance or surface.projection_distance
    cuts = np.cumsum([0] + [len(path.points) - 1 for path in paths])
    normal = np.vstack([paths[0].normal[:1], *[path.normal[1:] for path in paths]])
    # smoothed normals may be steeper than the steepest facet by what smoothing errs
    angle = np.minimum(np.arccos(np.clip(normal[:, 2], -1.0, 1.0)), surface.largest_angle)
    theta, ratio = adsif_surface.choose(surface, angle, spec.policy, spec.largest_variation)
    gap = ratio * job.sheet.thickness
    warnings = list(_flat_places(surface, angle))
    if spec.compensate_compliance:
        mean_radius = 0.5 * (job.tool_1.radius + job.tool_2.radius)
        deflection = _deflection(surface, theta, ratio, job_file)
        gap = adsif_surface.commanded_gap(gap, deflection, theta, mean_radius)
        place = np.vstack([paths[0].points[:1], *[path.points[1:] for path in paths]])
        warnings += _check_stiffness(gap, deflection, mean_radius, place)
    contours = []
    for k, path in enumerate(paths):
        span = slice(cuts[k], cuts[k + 1] + 1)
        contours.append(_contour(path, theta[span], gap[span], projection, k, len(paths), job_file, plan_id))
    joins = [path.joins for path in paths]
    made = contour_making.with_speed(contours, joins, job.path.acceleration)
    return tuple(made), tuple(warnings)


def _spiral(tree: LoopTree, target: TargetSurface, pitch: float, job_file: JobFile) -> list[TipPath]:
    """Turns of the projected spiral: once around the innermost loop, outwards by ``pitch``, once around the outermost.

    The coordinate of the loop family advances so that the widest place between two turns is one pitch; the number of
    turns is rounded to a whole one.
    """
    chain = [path_of(tree.loops[k]) for k in tree.features[0].loops][::-1]
    if job_file.job.path.direction == "cw":
        chain = [path.turned() for path in chain]
    spacing = job_file.job.path.point_spacing
    if len(chain) < 2:
        raise IsfError(
            ErrorCode.PATH_BROKEN,
            "the part has a single level: there is nothing to spiral through",
            where="path.incremental_depth",
            advice="reduce path.incremental_depth",
        )
    width = np.concatenate([[0.0], np.cumsum(family([path.points for path in chain], spacing / 2).gap())])
    turns = max(1, round(width[-1] / pitch))
    knots = 1.0 + width / width[-1] * turns
    return joined_paths.joined(
        target,
        chain,
        np.arange(turns + 3.0),
        lambda phase: np.interp(phase, knots, np.arange(len(knots), dtype=np.float64)),
        job_file.job.tool_1.radius,
        spacing,
    )


def _deflection(surface: AdsifSurface, theta: Array, ratio: Array, job_file: JobFile) -> Array:
    """(N,) m, how far both tools give way horizontally under the predicted forces, together."""
    forming, support = adsif_surface.tool_forces(surface, theta, ratio)
    first, second = job_file.rig.tool_1.compliance, job_file.rig.tool_2.compliance
    return np.asarray(forming * first[0] + support * second[0])


def _contour(
    path: TipPath, theta: Array, gap: Array, depth: float, index: int, count: int, job_file: JobFile, plan_id: str
) -> Contour:
    job = job_file.job
    assert job.tool_2 is not None
    radii = (job.tool_1.radius, job.tool_2.radius)
    tip = np.column_stack([path.points[:, :2], np.full(len(path.points), -depth)])
    wall_angle = np.arccos(np.clip(path.normal[:, 2], -1.0, 1.0))
    return Contour(
        plan_id=plan_id,
        index=index,
        count=count,
        process=Process.ADSIF,
        feed=job.path.feed,
        contact=tip + np.array([0.0, 0.0, radii[0]]) - radii[0] * path.normal,
        normal=path.normal,
        wall_angle=wall_angle,
        thickness=thickness_and_tips.sine_law(job.sheet.thickness, wall_angle),
        forming_tip=tip,
        support_tip=adsif_surface.support_tip(tip, path.outward(), theta, gap, radii),
        closed=False,
    ).validate()


def _flat_places(surface: AdsifSurface, angle: Array) -> tuple[str, ...]:
    flat = angle < surface.smallest_angle - FLATTER
    if not flat.any():
        return ()
    return (
        f"{100 * np.mean(flat):.0f} % of the path is flatter (down to {np.degrees(angle.min()):.1f} deg) than the "
        f"least that ADSIF with {surface.name} forms, {np.degrees(surface.smallest_angle):.1f} deg: too deep there",
    )


def _check_stiffness(gap: Array, deflection: Array, radius: float, place: Array) -> tuple[str, ...]:
    """Refuse tools that would have to overlap unloaded; warn where they give way by too much for the model.

    ``gap`` and ``deflection`` (N,) m, commanded and of both tools; the model takes deflections of a tenth of the
    ``radius`` (m) at most (Ren 2018, 3.3.1); ``place`` (N, 3) m.
    """
    worst = int(np.argmin(gap))
    if gap[worst] <= 0.0:
        raise IsfError(
            ErrorCode.ADSIF_NOT_REACHABLE,
            f"this rig is too soft: its tools give way by {deflection[worst] * 1e3:.2f} mm, so that they would have to "
            f"overlap by {-gap[worst] * 1e3:.2f} mm without a sheet between them",
            where=f"part at {place_text(place[worst])}",
            advice="make the wall flatter, use a stiffer rig, or set adsif.compensate_compliance: false",
        )
    most = int(np.argmax(deflection))
    if deflection[most] <= radius / 10:
        return ()
    return (
        f"at {place_text(place[most])} the tools give way by {deflection[most] * 1e3:.2f} mm, more than a tenth of "
        f"their radius: beyond the range in which the compensation was verified",
    )
