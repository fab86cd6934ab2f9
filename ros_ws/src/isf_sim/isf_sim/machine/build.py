"""The parts of a simulated machine from a job: plant, constants of the kernels, load cells, support under the sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from isf_core.files.job import JobFile
from isf_core.files.material import forming_limit
from isf_core.types import Array

from isf_sim.machine import tick as mt
from isf_sim.machine.axes import make_axis_errors, make_servo
from isf_sim.machine.events import EventLimits, event_limits
from isf_sim.machine.load_cells import CellState, make_cell
from isf_sim.plant_constants import PlantConstants
from isf_sim.sheet.adsif import AdsifConstants
from isf_sim.sheet.die_plant import DiePlant
from isf_sim.sheet.sheet_plant import LowerTool, SheetPlant
from isf_sim.sheet.squeeze import SqueezeConstants, indentation_stiffness
from isf_sim.sheet.support_surface import support_of
from isf_sim.variant import Variant

USUAL_PITCH = 0.2e-3
"""m between two turns, where the job does not say (Ren 2018, 3.2.1)."""


@dataclass(frozen=True)
class MachineParts:
    """Everything of a machine that a job, a variant and a generator decide.

    Attributes
    ----------
    plant : SheetPlant, its support in place
    constants : of the tick's kernels, for the upper and for the lower tool pressing ; cells : state of both load cells
    adsif : AdsifConstants, None unless the process is ADSIF ; support : (ny, nx) m, rigid surface, None without
    event_limits : EventLimits
    """

    plant: SheetPlant
    constants: tuple[mt.MachineConstants, mt.MachineConstants]
    cells: tuple[CellState, CellState]
    adsif: AdsifConstants | None
    support: Array | None
    event_limits: EventLimits


def make_parts(
    job_file: JobFile, variant: Variant, constants: PlantConstants, tip: Array, generator: np.random.Generator
) -> MachineParts:
    """Parts for a fresh blank with the forming tool parked at ``tip`` (3,) m; raises IsfError for the job's files."""
    job, rig = job_file.job, job_file.rig
    material = job_file.material.model_copy(
        update={"yield_strength": job_file.material.yield_strength * variant.yield_strength}
    )
    kind = DiePlant if job.process == "TPIF" else SheetPlant
    plant = kind(
        rig.clamp,
        material,
        job.sheet.thickness,
        job.tool_1.radius,
        job.path.incremental_depth,
        rig.tool_1.compliance,
        variant=variant,
        constants=constants,
        tip=tip,
        lower=LowerTool(job.tool_2.radius, rig.tool_2.compliance) if job.tool_2 else None,
    )
    support = support_of(job_file, plant.surface, plant.thickness)
    if support is not None:
        plant.set_support(support)
    rate, gain = job.control.rate, variant.load_cell_gain
    cell_1, state_1 = make_cell(rig.load_cell, constants, rate, gain, generator, weight=rig.tool_1.weight, above=True)
    cell_2, state_2 = make_cell(rig.load_cell, constants, rate, gain, generator, weight=rig.tool_2.weight, above=False)
    servo = make_servo(
        rig.servo.bandwidth,
        rig.servo.rate,
        rate,
        constants.servo_damping,
        constants.servo_pole_ratio,
        feedforward=rig.servo.velocity_feedforward,
        limit=rig.servo.following_error_limit,
    )
    of_tick = mt.MachineConstants(
        servo=servo,
        errors=make_axis_errors(rig),
        point=plant.sides[0],
        squeeze=_squeeze_constants(job_file, variant, constants, plant),
        cell_1=cell_1,
        cell_2=cell_2,
        force_limit=np.array(rig.limits.force),
    )
    return MachineParts(
        plant=plant,
        constants=(of_tick, of_tick._replace(point=plant.sides[1], squeeze=_swapped(of_tick.squeeze))),
        cells=(state_1, state_2),
        adsif=_adsif_constants(job_file, variant, plant) if job.process == "ADSIF" else None,
        support=support,
        event_limits=event_limits(
            # accumulative forming squeezes with up to 1500 N (Ren 2018, 3.2.4); no limit of chips is published for it
            math.inf if job.process == "ADSIF" else material.tensile_strength * variant.force_level,
            forming_limit(material),
            min(tool.ball_radius for tool in (job.tool_1, job.tool_2) if tool),
            plant.thickness,
            rate,
        ),
    )


def _squeeze_constants(
    job_file: JobFile, variant: Variant, constants: PlantConstants, plant: SheetPlant
) -> SqueezeConstants:
    job, rig, material = job_file.job, job_file.rig, plant.material
    flow = 0.5 * constants.flow_factor * (material.yield_strength + material.tensile_strength)
    radius_1 = job.tool_1.radius
    radius_2 = job.tool_2.radius if job.tool_2 else radius_1
    return SqueezeConstants(
        present=job.tool_2 is not None,
        forming_radius=radius_1,
        support_radius=radius_2,
        stiffness=indentation_stiffness(radius_1, radius_2, flow * variant.force_level, constants.indentation_factor),
        memory=constants.squeeze_memory,
        thickness=plant.thickness,
        window=constants.window_radii * radius_1,
        forming_compliance=np.array(rig.tool_1.compliance) * variant.compliance,
        support_compliance=np.array(rig.tool_2.compliance) * variant.compliance,
        flow_stress=flow * variant.force_level,
        constraint=constants.indentation_factor,
    )


def _swapped(c: SqueezeConstants) -> SqueezeConstants:
    """The same pair of tools with their roles exchanged."""
    return c._replace(
        forming_radius=c.support_radius,
        support_radius=c.forming_radius,
        window=c.window * c.support_radius / c.forming_radius,
        forming_compliance=c.support_compliance,
        support_compliance=c.forming_compliance,
    )


def _adsif_constants(job_file: JobFile, variant: Variant, plant: SheetPlant) -> AdsifConstants:
    job, rig = job_file.job, job_file.rig
    radius_1 = job.tool_1.radius
    return AdsifConstants(
        thickness=plant.thickness,
        radius_1=radius_1,
        radius_2=job.tool_2.radius if job.tool_2 else radius_1,
        compliance=(rig.tool_1.compliance[0] + rig.tool_2.compliance[0]) * variant.compliance,
        force_level=variant.force_level,
        width=max(1.5 * (job.adsif.pitch if job.adsif else USUAL_PITCH), 0.8 * plant.surface.h),
    )
