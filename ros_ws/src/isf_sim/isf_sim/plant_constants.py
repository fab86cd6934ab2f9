"""Constants of the plant that no rig or material file holds, each with where it comes from."""

from __future__ import annotations

from dataclasses import dataclass, field, fields


def _constant(default: float, provenance: str) -> float:
    return field(default=default, metadata={"provenance": provenance})


@dataclass(frozen=True)
class PlantConstants:
    """SI units; :func:`provenance` tells of each constant whether it is published, calibrated or assumed."""

    force_factor: float = _constant(0.0716, "published: Aerens et al. 2009, regression of the axial force, MPa mm deg")
    force_exponent: float = _constant(0.18, "published: Aerens et al. 2009, scallop^0.09, so the step^0.18")
    wrap_exponent: float = _constant(0.5, "assumed: growth of the force where the wall wraps round the tool")
    tangential_share: float = _constant(0.25, "assumed: share of the groove angle in the force along the motion")
    bulge_factor: float = _constant(0.8, "calibrated: at t/R = 0.3, on Behera's pyramid; grows with (t/R)^2")
    base_pillow: float = _constant(0.3, "assumed: pillow of the following base over the blank's thickness")
    squeeze_memory: float = _constant(0.5, "assumed: lasting part of the squeeze indentation")
    flow_factor: float = _constant(1.15, "assumed: plane-strain factor on the mean of yield and tensile strength")
    indentation_factor: float = _constant(2.8, "published: constraint factor of indentation (Tabor 1951)")
    window_radii: float = _constant(3.0, "assumed: path, in tool radii, in which a pass touches the same material")
    lag_length: float = _constant(2.0e-3, "assumed: travel over which lateral forces build up, m")
    fresh_depth: float = _constant(1.0e-3, "assumed: depth over which one coarse solution serves, m")
    fresh_distance: float = _constant(16.0e-3, "assumed: distance over which one coarse solution serves, m")
    coarse_cell: float = _constant(6.25e-3, "assumed: mean cell of the coarse shell, 40 over 250 mm")
    forming_cell: float = _constant(3.5e-3, "assumed: its smallest cell, where the sheet is formed")
    cell_growth: float = _constant(1.4, "assumed: largest ratio of its neighbouring cells")
    flange_cell: float = _constant(12.0e-3, "assumed: its largest cell, as far as the mean allows")
    fine_cell: float = _constant(0.5e-3, "assumed: grid of the conforming surface")
    track_cell: float = _constant(2.0e-3, "assumed: grid of tip track, base and bulge")
    edge_spring: float = _constant(1.0e6, "assumed: N/m^2, only keeps a free edge from drifting")
    shell_cell_radii: float = _constant(0.5, "assumed: cell of the elasto-plastic shell where it is formed, tool radii")
    shell_flange_cell: float = _constant(9.0e-3, "assumed: its largest cell, m")
    shell_speed: float = _constant(10.0, "assumed: speed of two tools on it, m/s: at 20 forces ripple by 5 %")
    shell_speed_alone: float = _constant(20.0, "assumed: speed of one tool on it, m/s: at 40 shapes change by 0.03 mm")
    shell_plunge_speed: float = _constant(
        0.4, "assumed: speed of tools across it in contact, m/s: at 0.8 shapes change by 0.02 mm"
    )
    shell_damping: float = _constant(2000.0, "assumed: mass-proportional damping of it, 1/s")
    servo_damping: float = _constant(0.75, "assumed: damping of the servo's pole pair")
    servo_pole_ratio: float = _constant(1.6, "assumed: real pole over natural frequency of the servo")
    drift: float = _constant(2.0, "assumed: standard deviation of a load cell's slow drift, N")
    drift_time: float = _constant(300.0, "assumed: correlation time of that drift, s")
    zero_offset: float = _constant(10.0, "assumed: largest reading of an unloaded cell before tare, N")
    jump_margin: float = _constant(2.0, "assumed: jump limit over the speed limit, for force and compliance offsets")

    def bulge_strength(self, thickness: float, radius: float) -> float:
        """c_b of the bulge overlay for a sheet and tool (m, m)."""
        return self.bulge_factor * (thickness / radius / 0.3) ** 2


def provenance() -> dict[str, str]:
    """Provenance of every constant by name."""
    return {item.name: item.metadata["provenance"] for item in fields(PlantConstants)}
