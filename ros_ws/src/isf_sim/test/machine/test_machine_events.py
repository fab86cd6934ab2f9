"""Events: each condition once per occurrence, with place and limit; the published limits of galling and thinning."""

from __future__ import annotations

import math

import pytest
from isf_core.events import Event, EventKind
from isf_core.files.material import FormingLimit, load_material
from isf_sim.machine.events import BUCKLES, EventWatch, TickFacts, event_bounds, event_limits, event_of, judge

RATE = 500.0
AA1100 = load_material("AA1100-O")
LIMITS = event_limits(AA1100.tensile_strength, FormingLimit(0.990, 1.0, 0.15), 4.5e-3, 1e-3, RATE)
BOUNDS = event_bounds(LIMITS, (4.5e-3, 4.5e-3), 1e-3)
QUIET = TickFacts(
    time=0.0,
    forming=(0.01, 0.0, -5e-3),
    support=(0.02, 0.0, -6e-3),
    axial=300.0,
    support_force=0.0,
    strain=0.0,
    thinnest=(0.012, 0.0, -3e-3),
    buckles=math.nan,
    clipped=0,
)


class Run:
    """Feeds a watch tick by tick."""

    def __init__(self) -> None:
        self.watch = EventWatch(LIMITS)
        self.tick = 0
        self.x = 0.0

    def hold(
        self,
        seconds: float,
        *,
        gap: float = 1e-3,
        on_support: bool = False,
        saturated: bool = False,
        speed: float = 30e-3,
        **facts: object,
    ) -> list[Event]:
        found = []
        for _ in range(round(seconds * RATE)):
            self.tick += 1
            reported = QUIET._replace(time=self.tick / RATE, **facts)
            bits = judge(
                reported.axial,
                reported.support_force,
                gap,
                reported.strain,
                2.0 * on_support,
                saturated,
                reported.clipped,
                BOUNDS,
            )
            bits |= 0 if math.isnan(reported.buckles) else BUCKLES
            self.x += speed / RATE
            kinds = self.watch.update(bits, self.tick * 30e-3 / RATE, self.x, 0.0)
            found += [event_of(kind, reported, LIMITS) for kind in kinds]
        return found


@pytest.mark.parametrize(("horizontal", "chips"), [(120.0, False), (200.0, True)])
def test_support_force_that_sheds_chips(horizontal: float, chips: bool) -> None:
    """Ren 2018, 2.4.1: AA1100-O of 1 mm, R 4.5 mm, wall of 65 deg: 120 N is fine, 200 N sheds chips."""
    force = horizontal / math.sin(math.radians(65.0))
    found = Run().hold(1.0, support_force=force)
    assert [event.kind for event in found] == ([EventKind.GALLING] if chips else [])
    for event in found:
        assert event.value == pytest.approx(force)
        assert event.limit == LIMITS.galling < force
        assert event.position == QUIET.support
        assert event.time == pytest.approx(0.01, abs=2.0 / RATE)


def test_an_occurrence_is_reported_once_and_again_after_a_pause() -> None:
    run = Run()
    assert len(run.hold(2.0, support_force=400.0)) == 1
    assert run.hold(0.2, support_force=100.0) == []
    assert run.hold(1.0, support_force=400.0) == []  # flicker
    assert run.hold(0.6, support_force=100.0) == []
    assert len(run.hold(1.0, support_force=400.0)) == 1


def test_contact_is_lost_only_after_it_was_there_and_while_the_tool_presses() -> None:
    run = Run()
    assert run.hold(1.0) == []  # never touched
    run.hold(0.5, support_force=80.0)
    assert run.hold(0.05) == []  # brief
    run.hold(0.5, support_force=80.0)
    lost = run.hold(1.0)
    assert [event.kind for event in lost] == [EventKind.CONTACT_LOST]
    assert lost[0].position == QUIET.support


def test_a_support_tool_that_is_moved_aside_while_the_forming_tool_stands_loses_nothing() -> None:
    """As for a tool lift: 2 mm aside, and back; once the forming tool goes on without it, it is lost."""
    run = Run()
    run.hold(0.5, support_force=80.0)
    assert run.hold(3.0, gap=2e-3, speed=0.0) == []
    run.hold(0.5, support_force=80.0, speed=0.0)
    assert run.hold(0.5, support_force=80.0) == []
    run.hold(1.0, gap=2e-3, speed=0.0)
    assert [event.kind for event in run.hold(1.0)] == [EventKind.CONTACT_LOST]


def test_tools_that_are_lifted_lose_nothing() -> None:
    run = Run()
    run.hold(0.5, support_force=80.0)
    assert run.hold(0.05, axial=0.0, gap=20e-3) == []
    assert run.hold(2.0, axial=300.0) == []


def test_sheet_tears_over_four_tool_radii_of_way_and_once() -> None:
    """Beyond the forming limit of 0.990, and the text says where."""
    run = Run()
    assert run.hold(0.5, strain=1.05) == []  # 15 mm of way: the seam
    assert run.hold(1.0, strain=0.98) == []
    torn = run.hold(1.0, strain=1.05)
    assert [event.kind for event in torn] == [EventKind.FRACTURE]
    assert torn[0].limit == pytest.approx(0.990, abs=1e-3)
    assert torn[0].position == QUIET.thinnest
    assert torn[0].text == "the sheet tears at (12.0, 0.0, -3.0) mm: strain 1.05, it bears 0.99"
    assert run.hold(2.0, strain=1.4) == []


def test_squeeze_delays_fracture() -> None:
    """200 N carry the strain 16 % further (funnel of Ren 2018, 2.4.1: 19.0 and 22.1 mm)."""
    assert Run().hold(1.0, strain=1.1, support_force=200.0, gap=1e-3)[-1].kind == EventKind.GALLING
    kinds = [event.kind for event in Run().hold(1.0, strain=1.16, support_force=200.0)]
    assert EventKind.FRACTURE in kinds


def test_buckling_die_contact_and_saturation() -> None:
    assert [e.kind for e in Run().hold(0.5, buckles=0.55)] == [EventKind.BUCKLING]
    assert [e.kind for e in Run().hold(0.5, on_support=True)] == [EventKind.DIE_CONTACT]
    assert [e.kind for e in Run().hold(0.5, clipped=1)] == [EventKind.SATURATION]
    assert [e.kind for e in Run().hold(0.5, saturated=True)] == [EventKind.SATURATION]
