"""Variants of the simulated plant: 0 is nominal, every other one is a seeded plant that differs from it.

Controllers are judged in several variants, because a real cell never has the constants of its model.

| numbers | what | for |
|---|---|---|
| 0 | nominal | - |
| 1-20 | factors on constants, registration of the scanner; documented results refer to them | choosing |
| 21-40 | these, and a plant of another structure (:class:`Variant`) | choosing |
| 101-120 | as 21-40, sealed: only to publish results, never to choose a constant or a method | publishing |

All other numbers are of the kind of 1-20. Nothing refuses a sealed variant; reports and ``--json`` mark its runs.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.hardening_law import FlowCurve, Voce
from isf_core.files.job import JobFile
from isf_core.files.material import LAWS, Material, flow_curve
from isf_core.files.rig import Clamp, ToolAxis
from isf_core.files.tooling import ToolSpec
from isf_core.simulated_sheet import is_structural
from isf_core.types import Array

from isf_sim.plant_constants import PlantConstants

STANDARD_VARIANTS = tuple(range(1, 21))
"""Numbers of the twenty variants of other constants, all of seed 0; 0 is nominal."""

MATCHED_STRAIN = 0.1
"""Plastic strain at which every flow curve of a variant has the stress of the material's."""
VOCE_STRAIN = 0.15
"""Plastic strain over which Voce's law comes to 63 % of its saturation (assumed)."""

FlowLaw = Literal["power", "voce"]


@dataclass(frozen=True)
class Variant:
    """How a plant differs from the nominal one; factors are 1 there, everything else 0.

    Factors on constants, in every variant but 0; uniform, half widths assumed:

    young_modulus 10 % ; thickness 5 % (rolling tolerance) ; force_level 15 % ; friction 20 % ; compliance 20 % ;
    load_cell_gain 3 % (calibration) ; edge_spring 0-60e6 N/m^2, in-plane, added to a free edge ; yield_strength 10 %
    registration_x, _y 0.2e-3 m, _z 0.1e-3 m, _turn 0.0035 rad : how far off a scanner believes the sheet to be

    Structure, in structural variants alone; ranges assumed but where a source stands:

    step_exponent : factor 0.6-1.6 on the exponent of the force over the step
    wrap_exponent : factor 0.4-1.6 on that over the wall round the tool
    ploughing : factor 0.3-2.0 on the force along the motion that grows with the groove: another law than Coulomb's
    edge_stiffness : 5e6-200e6 N/m^2, log-uniform; the in-plane spring of every rig, in place of its fixed or free edge
    edge_limit : 20e3-150e3 N/m, log-uniform; at which the sheet slips in the clamp
    flow_law : power or voce ; hardening : factor 0.6-1.4 on the exponent of the power law
    flange : 0-3e-3 m by which the free sheet is wider on every side
    tool_radius_1, _2 : factors 0.98-1.01, wear and grinding
    tool_offset_x, _y, _z : 0.15e-3, 0.15e-3, 0.05e-3 m either way, of tool 2 against tool 1
    clamp_x, clamp_y : 0.5e-3 m either way, of the clamp with all that is in it against the machine
    servo_bandwidth : factor 0.6-1.3 ; servo_damping : factor 0.75-1.2
    blank_thickness, blank_yield : factors 0.99-1.01, 0.97-1.03, another draw for every blank
    scan_noise : 50e-6-250e-6 m, standard deviation (published for a good scanner: within 50e-6, Lu 2016, 3.5.2)
    scan_bow : 0.2e-3 m either way, error of the scanned height from the middle to the corners
    scan_flattest : 0.85-1.2 rad between normal and view beyond which nothing is seen (0: the scanner's own)
    scan_shine : factor 1-4 on the number of mirroring patches
    scan_beyond : 10e-3-40e-3 m of clamp that is in the cloud as well
    """

    young_modulus: float = 1.0
    thickness: float = 1.0
    force_level: float = 1.0
    friction: float = 1.0
    compliance: float = 1.0
    load_cell_gain: float = 1.0
    edge_spring: float = 0.0
    yield_strength: float = 1.0
    registration_x: float = 0.0
    registration_y: float = 0.0
    registration_z: float = 0.0
    registration_turn: float = 0.0
    step_exponent: float = 1.0
    wrap_exponent: float = 1.0
    ploughing: float = 1.0
    edge_stiffness: float = 0.0
    edge_limit: float = 0.0
    flow_law: FlowLaw = "power"
    hardening: float = 1.0
    flange: float = 0.0
    tool_radius_1: float = 1.0
    tool_radius_2: float = 1.0
    tool_offset_x: float = 0.0
    tool_offset_y: float = 0.0
    tool_offset_z: float = 0.0
    clamp_x: float = 0.0
    clamp_y: float = 0.0
    servo_bandwidth: float = 1.0
    servo_damping: float = 1.0
    blank_thickness: float = 1.0
    blank_yield: float = 1.0
    scan_noise: float = 0.0
    scan_bow: float = 0.0
    scan_flattest: float = 0.0
    scan_shine: float = 1.0
    scan_beyond: float = 0.0

    def as_dict(self) -> dict[str, float | str]:
        """Name and value of every difference, for the record."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def constants(self, nominal: PlantConstants) -> PlantConstants:
        """Constants of the plant."""
        return replace(
            nominal,
            force_exponent=nominal.force_exponent * self.step_exponent,
            wrap_exponent=nominal.wrap_exponent * self.wrap_exponent,
            tangential_share=nominal.tangential_share * self.ploughing,
            servo_damping=nominal.servo_damping * self.servo_damping,
        )

    def plant_file(self, job_file: JobFile) -> JobFile:
        """``job_file`` as the plant is: its clamp, tools, servo and blank, which nobody else knows."""
        if self == replace(Variant(), **{name: getattr(self, name) for name in _FACTORS}):
            return job_file
        plant = copy.copy(job_file)
        job, rig, material = job_file.job, job_file.rig, job_file.material
        clamp = rig.clamp.model_copy(update={"size": tuple(size + 2.0 * self.flange for size in rig.clamp.size)})
        if self.edge_stiffness:
            clamp = clamp.model_copy(update={"edge": "free"})
        servo = rig.servo.model_copy(update={"bandwidth": rig.servo.bandwidth * self.servo_bandwidth})
        upper = (-self.clamp_x, -self.clamp_y, 0.0)
        lower = (self.tool_offset_x - self.clamp_x, self.tool_offset_y - self.clamp_y, self.tool_offset_z)
        axes = {"tool_1": _shifted(rig.tool_1, upper), "tool_2": _shifted(rig.tool_2, lower)}
        plant.rig = rig.model_copy(update={"clamp": clamp, "servo": servo, **axes})
        sheet = job.sheet.model_copy(update={"thickness": job.sheet.thickness * self.blank_thickness})
        tools = {"tool_1": _worn(job.tool_1, self.tool_radius_1)}
        if job.tool_2 is not None:
            tools["tool_2"] = _worn(job.tool_2, self.tool_radius_2)
        plant.job = job.model_copy(update={"sheet": sheet, **tools})
        strength = material.yield_strength * self.blank_yield
        plant.material = self._hardened(material).model_copy(update={"yield_strength": strength})
        return plant

    def edge(self, clamp: Clamp, nominal: float) -> tuple[float, float]:
        """N/m^2 and N/m, in-plane spring of the free edge of ``clamp`` and where it slips; the rig's where it gives
        them, else ``nominal`` and never."""
        spring = (nominal if clamp.edge_spring is None else clamp.edge_spring) + self.edge_spring
        limit = math.inf if clamp.edge_friction is None else clamp.edge_friction
        return self.edge_stiffness or spring, self.edge_limit or limit

    def flow_stress(self, material: Material, strain: Array) -> Array:
        """Pa, flow stress of the plant's ``material`` at the plastic ``strain``, without the factor ``force_level``.

        The factors on the yield strength, which ``material`` has already, are those of the first flow stress, whatever
        law the curve follows, and fade to 1 at MATCHED_STRAIN; no yield strength is above the stress there.
        """
        curve = flow_curve(material)
        if isinstance(curve, Voce):
            curve = replace(curve, yield_stress=min(curve.yield_stress, curve.saturation_stress))
        matched = float(curve.stress(MATCHED_STRAIN + curve.begin))
        # Voce's law and an estimated one are made of the yield strength
        more = 0.0 if curve.estimated or isinstance(curve, Voce) else self.yield_strength * self.blank_yield - 1.0

        def stress(strain: Array) -> Array:
            own = curve.stress(strain + curve.begin)
            if more == 0.0:
                return own
            scaled = np.minimum(own * (1.0 + more * (1.0 - strain / MATCHED_STRAIN)), matched)
            return np.where(strain < MATCHED_STRAIN, scaled, own)

        if self.flow_law == "power":
            return stress(strain)
        first = float(stress(np.zeros(1))[0])
        gain = (matched - first) / (1.0 - math.exp(-MATCHED_STRAIN / VOCE_STRAIN))
        return np.asarray(first + gain * (1.0 - np.exp(-strain / VOCE_STRAIN)))

    def _hardened(self, material: Material) -> Material:
        """``material`` with its flow stress over that at the matched strain to the power of ``hardening``."""
        if self.hardening == 1.0:
            return material
        curve = flow_curve(material)
        matched = float(curve.stress(MATCHED_STRAIN))
        if isinstance(curve, FlowCurve):
            exponent = curve.exponent * self.hardening
            coefficient = matched / MATCHED_STRAIN**exponent
            return material.model_copy(update={"hardening_exponent": exponent, "strength_coefficient": coefficient})
        strain = np.concatenate([[0.0], np.geomspace(1e-4, 4.0, 200)])
        stress = matched * (curve.stress(strain) / matched) ** self.hardening
        rows = tuple(zip(strain.tolist(), stress.tolist(), strict=True))
        others: dict[str, Any] = dict.fromkeys((name for law in LAWS for name in law), None)
        return material.model_copy(update={**others, "flow_curve": rows})


_FACTORS = tuple(item.name for item in fields(Variant))[:12]
"""Of the first kind."""


def make_variant(number: int, seed: int = 0, blank: int = 0) -> Variant:
    """Variant ``number`` of ``seed``, with its ``blank``: 0 is the one that the part is formed of, others are pushed.

    Raises
    ------
    IsfError : FILE_FIELD, a negative number
    """
    if number < 0:
        raise IsfError(ErrorCode.FILE_FIELD, f"variant is {number}, must be 0 or positive", where="variant")
    if number == 0:
        return Variant()
    draw = np.random.default_rng([number, seed % 2**63]).uniform
    factors = Variant(
        young_modulus=float(draw(0.9, 1.1)),
        thickness=float(draw(0.95, 1.05)),
        force_level=float(draw(0.85, 1.15)),
        friction=float(draw(0.8, 1.2)),
        compliance=float(draw(0.8, 1.2)),
        load_cell_gain=float(draw(0.97, 1.03)),
        edge_spring=float(draw(0.0, 60.0e6)),
        yield_strength=float(draw(0.9, 1.1)),
        registration_x=float(draw(-0.2e-3, 0.2e-3)),
        registration_y=float(draw(-0.2e-3, 0.2e-3)),
        registration_z=float(draw(-0.1e-3, 0.1e-3)),
        registration_turn=float(draw(-0.0035, 0.0035)),
    )
    return _structured(factors, number, seed, blank) if is_structural(number) else factors


def _structured(factors: Variant, number: int, seed: int, blank: int) -> Variant:
    draws = np.random.default_rng([number, seed % 2**63, 2])
    of_blank = np.random.default_rng([number, seed % 2**63, 3, blank])

    def between(low: float, high: float) -> float:
        return float(draws.uniform(low, high))

    return replace(
        factors,
        step_exponent=between(0.6, 1.6),
        wrap_exponent=between(0.4, 1.6),
        ploughing=between(0.3, 2.0),
        edge_stiffness=math.exp(between(math.log(5.0e6), math.log(200.0e6))),
        edge_limit=math.exp(between(math.log(20.0e3), math.log(150.0e3))),
        flow_law="voce" if draws.random() < 0.5 else "power",
        hardening=between(0.6, 1.4),
        flange=between(0.0, 3.0e-3),
        tool_radius_1=between(0.98, 1.01),
        tool_radius_2=between(0.98, 1.01),
        tool_offset_x=between(-0.15e-3, 0.15e-3),
        tool_offset_y=between(-0.15e-3, 0.15e-3),
        tool_offset_z=between(-0.05e-3, 0.05e-3),
        clamp_x=between(-0.5e-3, 0.5e-3),
        clamp_y=between(-0.5e-3, 0.5e-3),
        servo_bandwidth=between(0.6, 1.3),
        servo_damping=between(0.75, 1.2),
        scan_noise=between(50.0e-6, 250.0e-6),
        scan_bow=between(-0.2e-3, 0.2e-3),
        scan_flattest=between(0.85, 1.2),
        scan_shine=between(1.0, 4.0),
        scan_beyond=between(10.0e-3, 40.0e-3),
        blank_thickness=float(of_blank.uniform(0.99, 1.01)),
        blank_yield=float(of_blank.uniform(0.97, 1.03)),
    )


def _shifted(axis: ToolAxis, shift: tuple[float, float, float]) -> ToolAxis:
    """``axis`` with its true tip off by ``shift`` m, on top of the errors that it has."""
    tables = {}
    for name, off in zip(("error_x", "error_y", "error_z"), shift, strict=True):
        rows = getattr(axis, name) or ((0.0, 0.0),)
        if off:
            tables[name] = tuple((place, error + off) for place, error in rows)
    return axis.model_copy(update=tables)


def _worn(tool: ToolSpec, factor: float) -> ToolSpec:
    corner = tool.corner_radius and tool.corner_radius * factor
    return tool.model_copy(update={"radius": tool.radius * factor, "corner_radius": corner})
