"""Compliance compensation of a tool on a six-axis arm: in all three directions, with the stiffness of where it is.

What gives way is the arm, and by force in one direction it gives way in another one too, so the measured force acts
through the whole compliance matrix at the present tip (:func:`isf_core.geometry.serial_arm.compliance_field`). Force
and limits are handled as in :class:`isf_force_ctrl.laws.force_and_compliance.ComplianceCompensation`.
"""

from __future__ import annotations

from collections.abc import Sequence

from isf_core.geometry.serial_arm import TERMS, compliance_terms

from isf_force_ctrl.control_state import Flag
from isf_force_ctrl.laws.force_and_compliance import ComplianceSettings, Fir, limited


class ArmCompensation:
    """Offset of a tool in x, y and z; one call per tick.

    ``field`` (6 * TERMS,) m/N: the arm's compliance; ``own`` (3,) m/N: of tool and holder; ``factor``: 0..1 on both.
    """

    __slots__ = ("_field", "_firs", "_limit", "_own", "_raw", "_share", "_slew", "_slow", "flags", "x", "y", "z")

    def __init__(
        self, settings: ComplianceSettings, field: Sequence[float], own: Sequence[float], factor: float
    ) -> None:
        self._firs = tuple(Fir(settings.coefficients) for _ in range(3))
        self._slow = (0.0, 0.0, 0.0)
        self._raw = (0.0, 0.0, 0.0)
        self.x = self.y = self.z = 0.0
        """m, present offset."""
        self.flags = 0
        self._take(settings, field, own, factor)

    def retune(self, settings: ComplianceSettings, field: Sequence[float], own: Sequence[float], factor: float) -> None:
        """Other settings at the same rate; the offset goes on from where it is, no faster than its slew."""
        self._take(settings, field, own, factor)
        for fir in self._firs:
            fir.retune(settings.coefficients)

    def _take(self, settings: ComplianceSettings, field: Sequence[float], own: Sequence[float], factor: float) -> None:
        self._field = tuple(
            tuple(factor * value for value in field[k * TERMS : (k + 1) * TERMS]) for k in range(len(field) // TERMS)
        )
        self._own = tuple(factor * value for value in own)
        self._slew = settings.offset_slew / settings.rate
        self._limit = settings.offset_limit
        self._share = 1.0 / (1.0 + settings.smoothing_time * settings.rate)

    def step(
        self,
        force: tuple[float, float, float],
        normal: tuple[float, float],
        tip: tuple[float, float, float],
        tilt: tuple[float, float],
    ) -> None:
        """Take in the force of the sheet on the tool (3,) N of one tick at the commanded ``tip`` (3,) m and ``tilt``
        (2,) rad; ``normal`` (2,) is the unit vector that the horizontal force turns with."""
        n_x, n_y = normal
        slow_along, slow_across, slow_up = self._slow
        slow_along += self._share * (force[0] * n_x + force[1] * n_y - slow_along)
        slow_across += self._share * (force[1] * n_x - force[0] * n_y - slow_across)
        slow_up += self._share * (force[2] - slow_up)
        self._slow = (slow_along, slow_across, slow_up)
        f_x = slow_along * n_x - slow_across * n_y
        f_y = slow_along * n_y + slow_across * n_x
        terms = compliance_terms(*tip, *tilt)
        xx, yy, zz, xy, xz, yz = (sum(a * b for a, b in zip(row, terms, strict=True)) for row in self._field)
        own = self._own
        wanted = (
            -((xx + own[0]) * f_x + xy * f_y + xz * slow_up),
            -(xy * f_x + (yy + own[1]) * f_y + yz * slow_up),
            -(xz * f_x + yz * f_y + (zz + own[2]) * slow_up),
        )
        x, y, z = (limited(value, last, self._slew, self._limit) for value, last in zip(wanted, self._raw, strict=True))
        self.flags = 0 if (x, y, z) == wanted else int(Flag.SATURATED_COMPLIANCE)
        self._raw = (x, y, z)
        self._filter()

    def freeze(self) -> None:
        """Bring the offset to rest where it is."""
        self.flags = 0
        self._filter()

    def _filter(self) -> None:
        self.x, self.y, self.z = (fir.step(raw) for fir, raw in zip(self._firs, self._raw, strict=True))
