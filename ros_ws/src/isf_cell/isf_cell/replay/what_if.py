"""Other parameters for a recorded part, named as in the job and among the parameters of force control.

``control.compliance_compensation=0.5``, ``springback.gain=0.8``: a field of the job, with its unit.
``force.loop_gain=36`` (``force_ctrl.loop_gain`` as well): a parameter of force control, SI; ``force.integral_gain=80``:
the gain of its integrator K_i in um/(N s), in the terms of Ren 2018, 2.3.3, which is the loop gain over the contact
stiffness. What the plan is made from cannot be changed: the contours are those that were recorded.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import yaml
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import SpringbackSpec
from isf_core.files.quantity import LONGEST_SHOWN
from isf_force_ctrl.control_config import SET_WHILE_FORMING, ControlConfig

OF_JOB = (
    "control.compliance_compensation",
    "control.components",
    "control.support_compensation",
    "control.support_force",
    "control.tangential_force",
    "control.vertical_force",
    *(f"springback.{name}" for name in SpringbackSpec.model_fields if not name.startswith(("scan_", "lift_"))),
)
"""Fields of the job that do not change the plan, nor what is measured between contours."""

SET_POINT = "control.support_force"
SET_POINTS = (
    "control.components",
    SET_POINT,
    "control.tangential_force",
    "control.vertical_force",
)
"""Those among them that are, or decide, the force to be held."""

FIXED_BY_THE_JOB = ("control.components",)
"""Those among them that force control has from the begin of a part to its end."""

_LARGEST = 1e12
_NOT_FREE = ("rate", "travel", "support_force", "runs_on", "park_height", "aside", "ball_reach")
"""Parameters of force control that are not the controller's to choose."""

_NAMED_IN_THE_JOB = {
    "set_point": "control.support_force",
    "vertical": "control.components",
    "vertical_force": "control.vertical_force",
    "tangential": "control.components",
    "tangential_force": "control.tangential_force",
}
"""Parameters that are, or decide, the force to be held; a change of it is known by the name in the job alone."""

_KINDS = {
    item.name: str(item.type)
    for item in fields(ControlConfig)
    if item.name not in _NOT_FREE and item.name not in _NAMED_IN_THE_JOB
}
_COUNTS = {"Vector": 3, "tuple[float, float]": 2}

OF_FORCE = tuple(_KINDS)
INTEGRAL_GAIN = "integral_gain"
MID_PART = tuple(name for name in OF_FORCE if name in SET_WHILE_FORMING)
"""Those that may change in the middle of a part; the set-point, too, by its name in the job."""

RANGES = {
    "loop_gain": (0.1, 500.0),
    "dead_zone": (0.0, 100.0),
    "filter_cutoff": (1.0, 1000.0),
    "error_clamp": (1.0, 1000.0),
    "set_point_rate": (1.0, 1e5),
    "learning": (0.0, 1.0),
    "feed_error": (0.1, math.inf),
    "feed_floor": (0.01, 1.0),
    "seam_speed": (1e-4, math.inf),
    "oscillation_swing": (0.1, math.inf),
    "compliance_time": (0.0, 10.0),
    "contact_threshold": (0.1, 1000.0),
    "drift_limit": (0.1, 1e5),
    "drift_stop": (0.1, 1e5),
    "acceleration": (1e-3, 20.0),
    "compensation": (0.0, 1.0),
    "support_compensation": (0.0, 1.0),
    **dict.fromkeys(
        ("forming_compliance", "support_compliance", "axial_compliance", "offset_limit", "component_gain"),
        (0.0, _LARGEST),
    ),
    **dict.fromkeys(
        ("component_limit", "engage_force", "settled_time", "engage_timeout", "link_length", "seam_length"),
        (0.0, _LARGEST),
    ),
    "aside": (-_LARGEST, _LARGEST),
}
"""Smallest and largest value, SI; those of parameters of the node are the same there. All others are positive."""

_POSITIVE = (1e-12, _LARGEST)
MICRO = 1e-6


@dataclass(frozen=True)
class WhatIf:
    """Changes of a run.

    Attributes
    ----------
    given : values by name, as they were given
    of_job : values by field of the job (``springback.gain``)
    of_force : values by parameter of force control
    """

    given: Mapping[str, str]
    of_job: Mapping[str, Any]
    of_force: Mapping[str, Any]

    def __bool__(self) -> bool:
        return bool(self.given)

    @property
    def method(self) -> str | None:
        """Springback method, None: as recorded."""
        return self.of_job.get("springback.method")

    @property
    def changes_set_point(self) -> bool:
        """True when the force that is to be held is another one."""
        return any(name in self.of_job for name in SET_POINTS)

    def check_mid_part(self) -> None:
        """Raise IsfError FILE_FIELD for a change that cannot be made in the middle of a part."""
        for name in self.given:
            section, _, field = name.partition(".")
            fixed = name in FIXED_BY_THE_JOB
            if section in ("force", "force_ctrl"):
                fixed = field not in (*SET_WHILE_FORMING, INTEGRAL_GAIN)
            if fixed:
                raise _refused(
                    f"{name} cannot change in the middle of a part: force control has it from its begin to its end",
                    "leave --from out: the whole part is formed with it; from a contour on can change "
                    f"{', '.join(f'force.{item}' for item in (INTEGRAL_GAIN, *MID_PART))}, factors and forces of "
                    "control, springback",
                )

    def job_text(self, text: str) -> str:
        """The job ``text`` (YAML) with the changes of its fields."""
        if not self.of_job:
            return text
        data = yaml_file.content(text, "job")
        for name, value in self.of_job.items():
            *sections, field = name.split(".")
            place = data
            for section in sections:
                if place.get(section) is None:  # also "springback:" with nothing below it
                    place[section] = {}
                place = place[section]
                if not isinstance(place, dict):
                    raise _refused(f"{name}: {section} has no fields", f"its value alone: {section}=VALUE")
            place[field] = value
        return yaml.safe_dump(data, sort_keys=False, allow_unicode=True)

    def control(self, config: ControlConfig) -> ControlConfig:
        """``config`` with the changes of force control; raises IsfError UNSTABLE_GAIN, FILE_FIELD."""
        values = dict(self.of_force)
        if INTEGRAL_GAIN in values:
            values["loop_gain"] = values.pop(INTEGRAL_GAIN) * MICRO * config.contact_stiffness
            _checked("loop_gain", values["loop_gain"], f"force.{INTEGRAL_GAIN}: as a loop gain")
        changed = replace(config, **values)
        changed.check()
        return changed


def parse(changes: Sequence[str]) -> WhatIf:
    """Of texts "NAME=VALUE".

    Raises
    ------
    IsfError : FILE_FIELD, no such name, or no value
    """
    given: dict[str, str] = {}
    of_job: dict[str, Any] = {}
    of_force: dict[str, Any] = {}
    for change in changes:
        name, sign, text = (part.strip() for part in change.partition("="))
        if not sign or not text:
            raise _refused(f"'{change}' is not NAME=VALUE", "such as force.integral_gain=80")
        given[name] = text
        section, _, field = name.partition(".")
        if section in ("force", "force_ctrl"):
            known = _parameter(field, name)
            of_force[known] = _number(known, text)
        elif name == "control.support_force" and text == "auto":
            raise _refused(f"{name}: the plan chooses by wall angle", "a force, such as 120 N")
        elif _of_job(name):
            of_job[name] = _value(name, text)
        elif name in _OF_THE_RUN:
            raise _refused(
                f"{name}: another machine or blank would form another part",
                f"leave it out; ./isf simulate JOB --{name} {text} forms a part on it",
            )
        else:
            names = [*OF_JOB, *(f"force.{item}" for item in (*OF_FORCE, INTEGRAL_GAIN))]
            near = difflib.get_close_matches(name, names, n=2)
            advice = (
                f"did you mean {' or '.join(near)}?"
                if near
                else "fields of the job's control and springback, force.NAME"
            )
            what = (
                "the plan, or what was measured, would be another one" if section in _SECTIONS else "no such parameter"
            )
            raise _refused(f"{name}: {what}", advice)
    return WhatIf(given, of_job, of_force)


_SECTIONS = ("part", "sheet", "tool_1", "tool_2", "path", "adsif", "control", "springback", "rig", "process", "die")


_OF_THE_RUN = ("variant", "seed", "sheet")
"""Options of a run that say on what it was formed."""


def _of_job(name: str) -> bool:
    """A field that may be changed, or one inside of it (``springback.mpc.horizon``)."""
    return any(name == known or name.startswith(f"{known}.") for known in OF_JOB)


def _parameter(field: str, name: str) -> str:
    if field in (*OF_FORCE, INTEGRAL_GAIN):
        return field
    if field in _NAMED_IN_THE_JOB:
        raise _refused(f"{name}: the force to be held is the job's to say", f"use {_NAMED_IN_THE_JOB[field]}")
    near = difflib.get_close_matches(field, (*OF_FORCE, INTEGRAL_GAIN), n=2, cutoff=0.5)
    raise _refused(f"{name}: force control has no such parameter", f"did you mean {' or '.join(near)}?" if near else "")


def _value(name: str, text: str) -> Any:
    try:
        return yaml_file.content(text, name)
    except IsfError as error:
        shown = text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."
        raise _refused(f"{name}: '{shown}' is no value", "a number, a text, or a list [1, 2]") from error


def _number(field: str, text: str) -> Any:
    """Value of the type that the parameter has, inside its range."""
    name, kind, value = f"force.{field}", _KINDS.get(field, "float"), _value(f"force.{field}", text)
    if kind == "bool":
        if isinstance(value, bool):
            return value
        raise _refused(f"{name}: '{text}' is neither true nor false", f"{name}=true")
    count = _COUNTS.get(kind)
    if count is not None:
        if isinstance(value, list) and len(value) == count:
            return tuple(_float(field, item, text) for item in value)
        raise _refused(
            f"{name}: '{text}' is not {count} numbers in SI units", f"{name}=[{', '.join(['1e-6'] * count)}]"
        )
    return _float(field, value, text)


def _float(field: str, value: Any, text: str) -> float:
    try:
        if isinstance(value, bool):
            raise TypeError(text)
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise _refused(f"force.{field}: '{text}' is not a number in SI units", "such as force.loop_gain=36") from error
    return _checked(field, number, f"force.{field}")


def _checked(field: str, number: float, name: str) -> float:
    low, high = RANGES.get(field, _POSITIVE)
    if not low <= number <= high:  # NaN is not
        between = "a positive number" if (low, high) == _POSITIVE else f"{low:g} to {high:g}"
        raise _refused(f"{name}: {number:g} is out of range", f"{between}, in SI units")
    return number


def _refused(what: str, advice: str) -> IsfError:
    return IsfError(ErrorCode.FILE_FIELD, what, where="--what-if", advice=advice)
