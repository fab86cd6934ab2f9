"""Six hydraulic legs that move a platform, as a rig file describes them (Torrao 2013, chapters 3 to 5).

What the simulated machine is made of: position loops, valves, cylinders, pump, oil and transducers. Defaults are the
machine of the source; which of them it publishes and which are assumed, the rig `torrao2013` says constant by constant.
"""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from isf_core.files.quantity import (
    Compliance,
    Flow,
    Force,
    Frequency,
    HeatCapacity,
    HeatLoss,
    Length,
    Mass,
    Power,
    Pressure,
    Resistance,
    Temperature,
    Time,
    Voltage,
    Volume,
)
from isf_core.files.yaml_file import FileModel
from isf_core.process.cylinder_speed import free_speeds

Six = tuple[Length, Length, Length, Length, Length, Length]
Controller = Literal["fuzzy", "feedforward"]

OF_ONE_LEG = ("valve_stuck", "encoder_range", "encoder_stuck", "encoder_offset")


class FuzzyLoop(FileModel):
    """Mamdani controller of 49 rules as a table of 21 x 21 (Torrao 2013, chapter 5)."""

    error_gain: float = Field(default=0.1, gt=0)
    """K_e, 1/mm: an error of 1 / K_e is the largest one that counts (published: 10, for which these valves are too
    fast)."""
    rate_gain: float = Field(default=0.0, ge=0)
    """K_de, s/mm, of the error's rate of change (published: 0.1)."""
    output_gain: Voltage = Field(default=10.0, gt=0, le=10)
    """K_u: the valve's voltage for an output of 1."""
    filter_time: Time = Field(default=2e-3, ge=0)
    """Of the low-pass filter of that rate."""
    following_error: Length = Field(default=5e-3, gt=0)
    """Between set-point and reading of a leg; beyond it for 20 ms the machine stops."""


class FeedforwardLoop(FileModel):
    """Velocity of the set-point to the valve, and a proportional and integral correction of the position error."""

    gain: Frequency = Field(default=6.0, gt=0)
    """Speed per position error."""
    integral_time: Time = Field(default=0.25, gt=0)
    """Of the integral part."""
    lead: Time = Field(default=2.5e-3, ge=0)
    """By how much the velocity of the set-point is ahead: what the valve lags behind."""
    following_error: Length = Field(default=2e-3, gt=0)
    """Between set-point and reading of a leg; beyond it for 20 ms the machine stops."""


class Valve(FileModel):
    """Proportional valve of a leg, +-10 V, flow over opening linear beyond the dead band."""

    flow: Flow = Field(default=2e-4, gt=0)
    """Through one edge, fully open, at `pressure_drop`."""
    pressure_drop: Pressure = Field(default=35e5, gt=0)
    """Of that flow."""
    edge_ratio: float = Field(default=0.5, gt=0, le=2)
    """Flow of the edges of the rod's side over that of the piston's: 0.5 suits a cylinder of about half the area there,
    whose pressures then do not jump when it reverses."""
    bandwidth: Frequency = Field(default=150.0, gt=1, le=1000)
    """Natural frequency of the spool, second order."""
    damping: float = Field(default=0.8, gt=0, le=5)
    """Of the spool."""
    dead_band: float = Field(default=0.005, ge=0, lt=0.5)
    """Share of the voltage in which nothing flows, to either side."""
    leakage: Flow = Field(default=1e-5, ge=0)
    """From the supply to the tank at 210 bar."""
    vent: float = Field(default=1.0, gt=0, le=1)
    """Opening of both sides of the cylinder to the tank while the valve has no power."""


class Cylinder(FileModel):
    """Double-acting cylinder of a leg."""

    bore: Length = Field(default=0.063, gt=0)
    """Diameter of the piston."""
    rod: Length = Field(default=0.045, gt=0)
    """Diameter of the rod."""
    rod_mass: Mass = Field(default=8.0, gt=0)
    """Of piston and rod."""
    dead_volume: Volume = Field(default=1e-4, gt=0)
    """Oil between valve and piston at the end of its stroke, on each side."""
    leakage: Flow = Field(default=3e-7, ge=0)
    """Past the piston at 100 bar."""
    friction: Force = Field(default=80.0, ge=0)
    """Of the seals, of any speed."""
    viscous_friction: Resistance = Field(default=5000.0, ge=0)
    """Force per speed beside it."""
    compliance: Compliance = Field(default=12.5e-9, ge=0)
    """Of rod and both joints along the leg, which the transducer does not see."""
    errors: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """By how much each leg is longer than its transducer says."""

    @model_validator(mode="after")
    def _rod_in_bore(self) -> Cylinder:
        if self.rod >= self.bore:
            raise ValueError("rod must be thinner than bore")
        return self


class Supply(FileModel):
    """One pump with a relief valve and a tank, for all legs."""

    flow: Flow = Field(default=112e-3 / 60, gt=0)
    """Of the pump."""
    pressure: Pressure = Field(default=160e5, gt=0, le=500e5)
    """Of the relief valve."""
    lowest_pressure: Pressure = Field(default=100e5, gt=0)
    """Below it for `patience` the machine stops."""
    patience: Time = Field(default=0.2, gt=0)
    """Of the watch over the pressure."""
    line_volume: Volume = Field(default=2e-3, gt=0)
    """Oil between pump and valves."""
    bulk_modulus: Pressure = Field(default=1.2e9, gt=0)
    """Of the oil, with hoses and dissolved air."""
    heating: Power = Field(default=4520.0, ge=0)
    """Into the oil while the pump runs."""
    heat_capacity: HeatCapacity = Field(default=197.4e3, gt=0)
    """Of the oil in the tank."""
    cooler: bool = True
    """The cooler runs."""
    cooling: HeatLoss = Field(default=189.0, ge=0)
    """Of the cooler, per difference to the room."""
    ambient: Temperature = 25.0
    """Of the room, and of the oil at the start."""
    warm: Temperature = 50.0
    """Oil above it is told."""
    hottest: Temperature = 80.0
    """Oil above it stops the machine."""

    @model_validator(mode="after")
    def _pressures_in_order(self) -> Supply:
        if self.lowest_pressure >= self.pressure:
            raise ValueError("lowest_pressure must be below pressure")
        return self


class Encoder(FileModel):
    """Absolute transducer of a leg; it reads its stroke, 0 retracted."""

    resolution: Length = Field(default=2e-6, ge=0)
    """Smallest step."""
    noise: Length = Field(default=1.5e-6, ge=0)
    """Standard deviation of a reading."""


class Cables(FileModel):
    """Three cables from base to platform, which tell its place without the legs (Torrao 2013, 4.3.3)."""

    a: Length = 0.3
    """The cables begin at (0, 0), (0, c) and (a, b) of the base's plane, all shifted by `origin`."""
    b: Length = 0.15
    """See a."""
    c: Length = Field(default=0.3, gt=0)
    """See a."""
    origin: tuple[Length, Length] = (-0.1, -0.15)
    """Of the first cable in the base's frame."""
    noise: Length = Field(default=5e-5, ge=0)
    """Standard deviation of a cable's length."""
    limit: Length = Field(default=2e-3, gt=0)
    """Legs and cables that disagree by more about the place of the platform, for `patience`, stop the machine."""
    patience: Time = Field(default=0.1, gt=0)
    """Of that watch."""


class LegFault(FileModel):
    """What happens to the simulated machine."""

    kind: Literal[
        "valve_stuck",
        "encoder_range",
        "encoder_stuck",
        "encoder_offset",
        "pump_stop",
        "power_loss",
        "emergency_stop",
    ]
    """`valve_stuck`: the spool stays where it is; `encoder_range`: the transducer reads beyond its range;
    `encoder_stuck`: it reads the same for good; `encoder_offset`: it is off by `value`; `pump_stop`: the pump delivers
    nothing; `power_loss`: nor do the valves have power; `emergency_stop`: the button is pressed."""
    leg: int | None = Field(default=None, ge=1, le=6)
    """Of the first four kinds."""
    after: Time = Field(default=0.0, ge=0)
    """Of machine time since the blank was clamped."""
    value: Length = 0.0
    """Of an `encoder_offset`."""

    @model_validator(mode="after")
    def _with_its_kind(self) -> LegFault:
        if (self.kind in OF_ONE_LEG) != (self.leg is not None):
            raise ValueError(f"leg names the one that {', '.join(OF_ONE_LEG)} happen to, and of nothing else")
        if (self.kind == "encoder_offset") != (self.value != 0.0):
            raise ValueError("value is how far an encoder_offset is off, and of nothing else")
        return self


class HydraulicLegs(FileModel):
    """The legs of a hexapod with all that moves them."""

    controller: Controller = "feedforward"
    """Of the position loops: `fuzzy` as published, or `feedforward` of the velocity with a PI correction."""
    fuzzy: FuzzyLoop = FuzzyLoop()
    """The first of them."""
    feedforward: FeedforwardLoop = FeedforwardLoop()
    """The other."""
    valve: Valve = Valve()
    """Of each leg."""
    cylinder: Cylinder = Cylinder()
    """Of each leg."""
    supply: Supply = Supply()
    """Pump, oil and cooler."""
    encoder: Encoder = Encoder()
    """Of each leg."""
    cables: Cables | None = None
    """Three more sensors; None: there are none."""
    platform_mass: Mass = Field(default=30.0, gt=0)
    """Of the moving plate with joints and cells; spindle and tool are the weight of `tool_1`."""
    platform_gyration: Length = Field(default=0.15, gt=0)
    """Radius of gyration of that plate about the axis of the tool."""
    faults: tuple[LegFault, ...] = ()
    """What happens to the simulated machine, to try it."""

    @property
    def areas(self) -> tuple[float, float]:
        """m^2, of the piston and of the rod's side of a cylinder."""
        bore, rod = self.cylinder.bore, self.cylinder.rod
        return 0.25 * math.pi * bore**2, 0.25 * math.pi * (bore**2 - rod**2)

    @property
    def free_speeds(self) -> tuple[float, float]:
        """m/s, of one unloaded leg outwards and inwards, with its valve fully open."""
        rated = self.valve.flow / math.sqrt(self.valve.pressure_drop)
        return free_speeds(self.areas, (rated, self.valve.edge_ratio * rated), self.supply.pressure)

    @property
    def spare_flow(self) -> float:
        """m^3/s, of the pump beyond what all valves leak."""
        return self.supply.flow - 6.0 * self.valve.leakage
