"""Set-points that differ by wall, corner, angle and depth, from the job into the contours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from isf_core.contour import Contour
from isf_core.errors import IsfError
from isf_core.files.job import ForceRule, JobFile, WallFacts, ruled_forces
from isf_planner import plan
from isf_planner.paths.joined_paths import TipPath
from isf_planner.paths.support_tool import facts_of, wall_facts

JOBS = Path(__file__).resolve().parents[5] / "examples" / "jobs"

WALLS = """
  force_rules:
    - {facing: [-45 deg, 45 deg], force: 200 N}
    - {facing: [135 deg, -135 deg], force: 100 N}
    - {wall_angle: [0 deg, 40 deg], force: 90 N}
"""


def planned(name: str, rules: str) -> tuple[Contour, ...]:
    return tuple(plan(_with_rules(name, rules)).contours)


def _with_rules(name: str, rules: str) -> JobFile:
    text = (JOBS / f"{name}.yaml").read_text()
    return JobFile(text.replace("\nspringback:", rules + "springback:"), JOBS)


def test_adjacent_walls_of_a_pyramid_have_their_own_forces() -> None:
    # Ren 2018, 2.4, case C: 100 to 200 N, different on adjacent walls; elsewhere the job's 120 N.
    contours = planned("ren_pyramid", WALLS)
    plain = planned("ren_pyramid", "\n")
    assert [c.force_controlled for c in contours] == [c.force_controlled for c in plain]
    forced = [contour for contour in contours if contour.force_controlled]
    for contour in forced:
        out = -contour.normal[:, :2]
        flat = contour.wall_angle < np.radians(39.9)
        steep = contour.wall_angle > np.radians(40.1)
        right = steep & (out[:, 0] > 1.05 * np.abs(out[:, 1]))
        left = steep & (-out[:, 0] > 1.05 * np.abs(out[:, 1]))
        other = steep & (np.abs(out[:, 1]) > 1.05 * np.abs(out[:, 0]))
        assert (contour.support_force[right] == 200.0).all()
        assert (contour.support_force[left] == 100.0).all()
        assert (contour.support_force[other] == 120.0).all()
        assert (contour.support_force[flat] == 90.0).all()
    assert any((contour.support_force == 90.0).all() for contour in forced)  # the last one, in the floor's fillet
    assert sum((contour.support_force == 200.0).any() for contour in forced) > 20


@pytest.mark.parametrize("turns", [1.0, -1.0])
@pytest.mark.parametrize("closed", [True, False])
def test_facts_of_a_ring(turns: float, closed: bool) -> None:
    radius, points = 12e-3, 150
    angle = turns * np.linspace(0.0, 2.0 * np.pi, points, endpoint=not closed)
    line = radius * np.column_stack([np.cos(angle), np.sin(angle), np.full(points, -4e-3 / radius)])
    path = TipPath(line, np.tile([0.0, 0.0, 1.0], (points, 1)), closed=closed, wall_right=turns > 0)
    facts = wall_facts(path, np.full(points, 0.8), np.full(points, 4e-3))
    inner = slice(None) if closed else slice(5, -5)
    assert np.cos(facts.facing - angle)[inner] == pytest.approx(1.0, abs=1e-3)
    assert facts.corner_radius[inner] == pytest.approx(radius, rel=0.02)


def test_a_straight_line_has_no_corner() -> None:
    line = np.column_stack([np.linspace(0.0, 0.05, 100), np.zeros(100), np.full(100, -3e-3)])
    path = TipPath(line, np.tile([0.0, 0.0, 1.0], (100, 1)), closed=False)
    assert np.isinf(wall_facts(path, np.full(100, 0.8), np.full(100, 3e-3)).corner_radius).all()


def test_the_last_rule_counts_and_all_conditions_hold_together() -> None:
    count = 5
    facts = WallFacts(
        facing=np.radians([0.0, 90.0, 180.0, 270.0, 360.0]),
        wall_angle=np.radians([30.0, 40.0, 50.0, 60.0, 65.0]),
        corner_radius=np.array([np.inf, 0.01, 0.02, np.inf, 0.005]),
        depth=1e-3 * np.arange(count),
        x=np.zeros(count),
        y=np.linspace(-1.0, 1.0, count),
    )

    def forces(*rules: dict[str, object]) -> list[float]:
        return ruled_forces([ForceRule.model_validate(rule) for rule in rules], 120.0, facts).tolist()

    assert forces() == [120.0] * 5
    assert forces({"force": "80 N", "corner_radius": ["0 mm", "15 mm"]}) == [120.0, 80.0, 120.0, 120.0, 80.0]
    across = {"force": "80 N", "facing": ["-10 deg", "100 deg"]}  # over the x axis, whatever turn the angle is in
    assert forces(across) == [80.0, 80.0, 120.0, 120.0, 80.0]
    both = {"force": "150 N", "facing": ["-10 deg", "100 deg"], "wall_angle": ["35 deg", "90 deg"]}
    assert forces(across, both) == [80.0, 150.0, 120.0, 120.0, 150.0]
    assert forces({"force": "90 N", "depth": ["2 mm", "3 mm"], "y": ["0.2 m", "1 m"]}) == [
        120.0,
        120.0,
        120.0,
        90.0,
        120.0,
    ]


@pytest.mark.parametrize(
    ("rules", "reported"),
    [
        ("\n  force_rules: [{force: 80 N}]\n", "names no place"),
        ("\n  force_rules: [{force: 80 N, depth: [4 mm, 2 mm]}]\n", "smaller to a larger"),
        ("\n  force_rules: [{force: 80 N, depth: [-4 mm, 2 mm]}]\n", "never negative"),
        ("\n  force_rules: [{force: 80 N, corner_radius: [-4 mm, 2 mm]}]\n", "never negative"),
        ("\n  force_rules: [{force: 80 N, facing: [10 deg, 10 deg]}]\n", "begins where it ends"),
        ("\n  force_rules: [{force: 80 N, facing: [10 deg, 400 deg]}]\n", "within -360 and 360"),
        ("\n  force_rules: [{force: 0 N, x: [0 mm, 2 mm]}]\n", "greater than 0"),
        ("\n  force_rules: [{force: 80 N, height: [0 mm, 2 mm]}]\n", "height"),
    ],
)
def test_rules_that_make_no_sense_are_refused(rules: str, reported: str) -> None:
    with pytest.raises(IsfError, match=reported):
        planned("mini_cone", rules)


def test_rules_without_effect_and_forces_that_shed_chips_are_warned_of() -> None:
    rules = """
  force_rules:
    - {facing: [0 deg, 90 deg], force: 110 N}
    - {depth: [200 mm, 300 mm], force: 110 N}
    - {facing: [180 deg, 270 deg], force: 600 N}
    - {facing: [-10 deg, 100 deg], force: 130 N}
"""
    made = plan(_with_rules("mini_cone", rules))
    reported = [text for text in made.warnings if "force rule" in text]
    assert [text.split(" (")[0] for text in reported] == ["force rule 1", "force rule 2", "force rule 3"]
    assert "later rules" in reported[0]
    assert "on no point" in reported[1]
    assert "may shed chips" in reported[2]
    assert not [
        text
        for text in plan(_with_rules("ren_pyramid", WALLS[: WALLS.index("    - {wall_angle")])).warnings
        if "force rule" in text
    ]


def test_the_facts_of_the_warnings_are_those_of_the_set_points() -> None:
    """Every rule that made a set-point is found to hold there, and nowhere else."""
    job_file = _with_rules("ren_pyramid", WALLS)
    for contour in plan(job_file).contours:
        if contour.force_controlled:
            forces = ruled_forces(job_file.job.control.force_rules, 120.0, facts_of(contour, 0.0, 1e-3))
            assert np.mean(forces == contour.support_force) > 0.99


def test_rules_need_a_force() -> None:
    text = (JOBS / "mini_cone.yaml").read_text().replace("support_force: 120 N", "support_force: 0 N")
    text = text.replace("\nspringback:", "\n  force_rules: [{force: 80 N, x: [0 mm, 2 mm]}]\nspringback:")
    with pytest.raises(IsfError, match="no effect"):
        JobFile(text, JOBS)
