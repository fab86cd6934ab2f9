"""Physical quantities in files: a number with its unit in the file, SI inside.

Text such as ``5 mm``, ``30 mm/s`` or ``1 um/N`` is converted with pint. A bare number
in a file is refused: nobody should have to guess its unit. Python code that builds the
models directly passes plain SI floats.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, ValidationInfo
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from pint import UnitRegistry
    from pint.facets.plain import PlainQuantity

_NUMBER = r"[+-]?(?:\d{1,30}\.?\d{0,30}|\.\d{1,30})(?:[eE][+-]?\d{1,3})?"
_UNIT = r"(?:[^\W\d_]\w{0,20}|[%°])(?:\s*(?:\*\*|\^)\s*-?\d)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*((?:(?<=\s)1\s*/\s*)?{_UNIT}(?:\s*[*/·]\s*{_UNIT}){{0,5}})\s*")
"""A number and its unit: names with a power of one digit, multiplied or divided. What is more would be calculated by
pint, 9**9**9 mm too."""

FROM_FILE = {"from_file": True}
"""Validation context that switches on the demand for units."""


LONGEST_SHOWN = 100
"""Characters of a quantity, and of a text that is none in an error."""


@cache
def _registry() -> UnitRegistry[Any]:
    from pint import UnitRegistry  # imported late: 0.2 s that programs without files need not pay

    return UnitRegistry()


def parse(text: str, unit: str) -> float:
    """Value of ``text`` ("5 mm") in the SI ``unit`` ("m").

    Raises
    ------
    ValueError : not one number with a unit, not finite, or of another dimension; an angle is one, too
    """
    import pint

    shown = repr(text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}...")
    found = _QUANTITY.fullmatch(text) if len(text) <= LONGEST_SHOWN else None
    if found is None:
        raise ValueError(f"{shown} is not a number with a unit")
    try:
        quantity = _registry().Quantity(float(found[1]), found[2].replace("·", "*"))
        value = float(quantity.to(unit).magnitude)
        angle = _power_of_angle(quantity)
    except pint.DimensionalityError as error:
        raise ValueError(f"{shown} is not a quantity in {unit}") from error
    except Exception as error:  # pint raises its own, and tokenizer errors, for what is no unit
        raise ValueError(f"{shown} is not a number with a unit") from error
    if not math.isfinite(value):
        raise ValueError(f"{shown} is not finite")
    if angle != _power_of_angle(_registry().Quantity(1.0, unit)):  # to pint 157 rad/s are 157 Hz, and 50 % half a rad
        raise ValueError(f"{shown} is not a quantity in {unit}: they differ by an angle")
    return value


def _power_of_angle(quantity: PlainQuantity[Any]) -> float:
    """1 of an angle and an angular speed, 0 of a frequency."""
    powers: dict[str, Any] = dict(quantity.to_root_units().unit_items())
    return float(powers.get("radian", 0.0))


def _to_si(unit: str, example: str) -> Callable[[Any, ValidationInfo], Any]:
    def convert(value: Any, info: ValidationInfo) -> Any:
        from_file = bool(info.context and info.context.get("from_file"))
        if isinstance(value, str):
            try:
                return parse(value, unit)
            except ValueError as error:
                raise PydanticCustomError(
                    "unit", "{reason}; write for example {example}", {"reason": str(error), "example": example}
                ) from error
        if from_file and isinstance(value, int | float):
            raise PydanticCustomError(
                "unit",
                "{value} has no unit; write for example {example}",
                {"value": str(value).lower(), "example": example},
            )
        return value

    return convert


@dataclass(frozen=True)
class Reading:
    """The ``unit`` in which people read a quantity, ``size`` in SI; stands in the annotation of its type."""

    unit: str
    size: float

    def text(self, value: float) -> str:
        """``value`` (SI) as a person reads it."""
        return f"{value / self.size:.6g} {self.unit}"


Length = Annotated[float, BeforeValidator(_to_si("m", "5 mm")), Reading("mm", 1e-3)]
Speed = Annotated[float, BeforeValidator(_to_si("m/s", "30 mm/s")), Reading("mm/s", 1e-3)]
Acceleration = Annotated[float, BeforeValidator(_to_si("m/s**2", "500 mm/s**2")), Reading("mm/s**2", 1e-3)]
Force = Annotated[float, BeforeValidator(_to_si("N", "120 N")), Reading("N", 1.0)]
Torque = Annotated[float, BeforeValidator(_to_si("N*m", "5 N*m")), Reading("N*m", 1.0)]
Stress = Annotated[float, BeforeValidator(_to_si("Pa", "70 GPa")), Reading("MPa", 1e6)]
Angle = Annotated[float, BeforeValidator(_to_si("rad", "50 deg")), Reading("deg", math.pi / 180.0)]
AngularSpeed = Annotated[float, BeforeValidator(_to_si("rad/s", "10 deg/s")), Reading("deg/s", math.pi / 180.0)]
SpindleSpeed = Annotated[float, BeforeValidator(_to_si("rad/s", "65 rpm")), Reading("rpm", math.pi / 30.0)]
Compliance = Annotated[float, BeforeValidator(_to_si("m/N", "1.0 um/N")), Reading("um/N", 1e-6)]
Stiffness = Annotated[float, BeforeValidator(_to_si("N/m", "0.45 N/um")), Reading("N/um", 1e6)]
AngularStiffness = Annotated[float, BeforeValidator(_to_si("N*m/rad", "1.5 MN*m/rad")), Reading("kN*m/rad", 1e3)]
EdgeStiffness = Annotated[float, BeforeValidator(_to_si("N/m**2", "50 N/mm/mm")), Reading("N/mm/mm", 1e6)]
EdgeForce = Annotated[float, BeforeValidator(_to_si("N/m", "200 N/mm")), Reading("N/mm", 1e3)]
Frequency = Annotated[float, BeforeValidator(_to_si("1/s", "500 Hz")), Reading("Hz", 1.0)]
Time = Annotated[float, BeforeValidator(_to_si("s", "0.1 s")), Reading("s", 1.0)]
Voltage = Annotated[float, BeforeValidator(_to_si("V", "10 V")), Reading("V", 1.0)]
VoltageGain = Annotated[float, BeforeValidator(_to_si("N/V", "2400 N/V")), Reading("N/V", 1.0)]
Flow = Annotated[float, BeforeValidator(_to_si("m**3/s", "12 l/min")), Reading("l/min", 1e-3 / 60.0)]
Pressure = Annotated[float, BeforeValidator(_to_si("Pa", "160 bar")), Reading("bar", 1e5)]
Volume = Annotated[float, BeforeValidator(_to_si("m**3", "0.1 l")), Reading("l", 1e-3)]
Mass = Annotated[float, BeforeValidator(_to_si("kg", "30 kg")), Reading("kg", 1.0)]
Power = Annotated[float, BeforeValidator(_to_si("W", "4.5 kW")), Reading("W", 1.0)]
HeatLoss = Annotated[float, BeforeValidator(_to_si("W/K", "190 W/K")), Reading("W/K", 1.0)]
HeatCapacity = Annotated[float, BeforeValidator(_to_si("J/K", "200 kJ/K")), Reading("J/K", 1.0)]
Resistance = Annotated[float, BeforeValidator(_to_si("N*s/m", "2 N*s/mm")), Reading("N*s/m", 1.0)]
Temperature = Annotated[float, BeforeValidator(_to_si("degC", "25 degC")), Reading("degC", 1.0)]
