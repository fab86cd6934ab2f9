"""Accuracy surfaces against parts whose deviation is made by a known law, and targets moved against it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner import exports, plan
from isf_planner.accuracy import formed_parts, surfaces
from isf_planner.accuracy.formed_parts import Conditions, FormedPart, FormedParts, formed_part
from isf_planner.accuracy.moved_target import divided, jacobians, move_target
from isf_planner.accuracy.places import KINDS, NUMBERS, PREDICTORS, find_places
from isf_planner.accuracy.surfaces import Expected
from isf_planner.features.surface_features import Kind
from isf_planner.part.meshes import Mesh, load_mesh, topology
from isf_planner.surface.target_surface import target_map
from planner_parts import NO_PASSES, Cone, job_for, write

RADIUS, BLANK, CLAMP = 5e-3, 1e-3, (0.182, 0.182)
CONES = [
    Cone(opening=opening, angle=np.radians(angle), depth=depth)
    for opening, angle, depth in (
        (24e-3, 38.0, 8e-3),
        (28e-3, 45.0, 10e-3),
        (32e-3, 50.0, 14e-3),
        (36e-3, 42.0, 12e-3),
        (30e-3, 40.0, 9e-3),
        (26e-3, 48.0, 11e-3),
    )
]

LONG = Cone(opening=55e-3, angle=np.radians(50.0), depth=32e-3)


def law(angle: Array, depth: Array) -> Array:
    """m along the normal: what the parts of these tests deviate by."""
    return 0.1e-3 + 0.3e-3 * angle + 20e-6 * (1e3 * depth)


def formed(cone: Cone, name: str) -> FormedPart:
    """A part of ``cone`` that deviates by the law, over a flange that stays."""
    target = target_map(cone.mesh(2e-5), CLAMP)
    slope = np.hypot(*target.gradient())
    error = law(np.arctan(slope), -target.z) * np.sqrt(1.0 + slope**2)
    return formed_part(
        name, target, HeightMap(target.x, target.y, target.z + np.where(target.z < 0, error, 0.0)), RADIUS, BLANK
    )


@pytest.fixture(scope="module")
def learned() -> FormedParts:
    conditions = Conditions("SPIF", "AA5754-O", RADIUS, "none", plate=False)
    parts = tuple(formed(cone, f"cone_{k}") for k, cone in enumerate(CONES))
    return surfaces.with_held_out(FormedParts(conditions, parts))


def column(name: str) -> int:
    return PREDICTORS.index(name)


def test_the_places_of_a_cone_are_those_of_its_profile() -> None:
    cone = LONG
    places = find_places(target_map(cone.mesh(2e-5), CLAMP), RADIUS, BLANK)
    assert places is not None
    points = places.heights.points()
    r = np.hypot(points[:, 0], points[:, 1])
    # the straight wall, where the fillets no longer have a part in the averaged normal
    low, high = cone.floor_begin + 8e-3, cone.entry_end - 8e-3
    wall = (points[:, 2] > low) & (points[:, 2] < high)
    value = places.values[wall]
    assert np.degrees(value[:, 0]).mean() == pytest.approx(50.0, abs=1.5)
    # along the profile: the entry arc from where it is 0.1 mm deep, then straight down
    begins = np.arccos(1.0 - 0.1e-3 / cone.entry)
    way = cone.entry * (cone.angle - begins) + (cone.entry_end - points[wall, 2]) / np.sin(cone.angle)
    assert np.abs(value[:, column("distance to the rim along the wall [m]")] - way).max() < 1.5e-3
    middle = r < 1e-3
    assert places.values[middle][:, column(Kind.FLOOR.value)].all()
    assert (places.values[middle][:, column("distance to the floor along the wall, negative on it [m]")] < 0).all()
    outward = points[wall, :2] / r[wall, None]
    turned = (places.normal[wall, :2] * outward).sum(axis=1) / np.hypot(*places.normal[wall, :2].T)
    assert (turned < -0.99).all()  # the upper face looks inwards


def test_a_cone_that_was_held_out_is_predicted_from_the_others(learned: FormedParts) -> None:
    assert len(learned.shapes) == 6
    for part in learned.parts:
        assert part.left < 0.25 * part.rms(part.deviation)
    assert 0.0 < learned.uncertainty < 0.12e-3


def test_too_few_shapes_are_refused_even_as_many_parts(learned: FormedParts) -> None:
    again = replace(learned, parts=(*learned.parts[:3], *learned.parts[:3]))
    with pytest.raises(IsfError, match=r"3 different part\(s\), 4 are needed") as refused:
        surfaces.with_held_out(again)
    assert refused.value.code == ErrorCode.LEARNING_UNUSABLE


def test_where_nothing_was_learned_nothing_is_corrected(learned: FormedParts) -> None:
    model = surfaces.fit(learned.parts)
    deep = find_places(target_map(Cone(opening=50e-3, depth=30e-3).mesh(2e-5), CLAMP), RADIUS, BLANK)
    known = find_places(target_map(CONES[1].mesh(2e-5), CLAMP), RADIUS, BLANK)
    assert deep is not None
    assert known is not None
    far, near = model.expect(deep), model.expect(known)
    assert (far.trust[deep.formed.ravel()] == 0.0).all()  # its depth alone is far from all that was learned
    assert any("depth of the part [m]: 100%" in remark for remark in far.remarks)
    assert near.trust[known.formed.ravel()].mean() > 0.97
    # a kind of feature that no part had
    values = known.values.copy()
    values[:, len(NUMBERS) :] = 0.0
    values[:, column(Kind.RIB_SEMI_VERTICAL.value)] = 1.0
    other = model.expect(replace(known, values=values))
    assert (other.trust == 0.0).all()
    assert not model.kinds[KINDS.index(Kind.RIB_SEMI_VERTICAL)]


def test_trust_fades_without_a_step(learned: FormedParts) -> None:
    model = surfaces.fit(learned.parts)
    places = find_places(target_map(CONES[1].mesh(2e-5), CLAMP), RADIUS, BLANK)
    assert places is not None
    k = column("depth of the part [m]")
    low, high = model.low[k], model.high[k]
    row = places.values[places.formed.ravel()][:1]
    steps = np.linspace(high, high + 0.3 * (high - low), 61)
    values = np.repeat(row, len(steps), axis=0)
    values[:, k] = steps
    trust, _ = model._trust(values, np.ones(len(steps), dtype=np.bool_))
    assert trust[-1] == 0.0
    assert (np.diff(trust) <= 1e-12).all()
    assert np.abs(np.diff(trust)).max() < 0.05 * trust[0]


def expecting(places: object, value: float | Array) -> Expected:
    count = len(places.values)  # type: ignore[attr-defined]
    formed_nodes = places.formed.ravel()  # type: ignore[attr-defined]
    return Expected(np.broadcast_to(value, (count,)) * formed_nodes, formed_nodes.astype(float), ())


def test_a_target_moves_along_its_normal_and_its_flange_stays() -> None:
    cone = LONG
    mesh = cone.mesh(2e-5)
    places = find_places(target_map(mesh, CLAMP), RADIUS, BLANK)
    assert places is not None
    moved = move_target(mesh, places, expecting(places, 0.4e-3), RADIUS, 0.0)
    before, after = moved.nominal.vertices, moved.moved.vertices
    r = np.hypot(before[:, 0], before[:, 1])
    floor = r < 4e-3
    assert np.allclose(after[floor, 2], -cone.depth - 0.4e-3, atol=2e-6)
    wall = (before[:, 2] > cone.floor_begin + 8e-3) & (before[:, 2] < cone.entry_end - 8e-3)
    away = np.hypot(after[wall, 0], after[wall, 1]) - r[wall]
    assert np.allclose(away, 0.4e-3 * np.sin(cone.angle), atol=0.03e-3)
    assert np.allclose(before[wall, 2] - after[wall, 2], 0.4e-3 * np.cos(cone.angle), atol=0.03e-3)
    flange = r > cone.profile(2e-5)[1, 0] + 1.5e-3
    assert flange.sum() > 100
    assert np.array_equal(after[flange], before[flange])
    assert moved.outside == 0.0
    assert moved.smallest_jacobian > 0.5
    assert moved.warnings == ()


def test_a_move_that_would_fold_the_target_is_eased_off() -> None:
    mesh = CONES[1].mesh(2e-5)
    places = find_places(target_map(mesh, CLAMP), 1e-3, BLANK)
    assert places is not None
    rough = 6e-3 * np.sign(np.sin(2.0 * np.pi * places.heights.points()[:, 0] / 4e-3))
    moved = move_target(mesh, places, expecting(places, rough), 1e-3, 0.0)
    # independent of the software's own measure: every facet looks up, and no two lie over each other
    corners = moved.moved.corners()
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (across > 0.0).all()
    plain = moved.nominal.corners()
    area = np.cross(plain[:, 1] - plain[:, 0], plain[:, 2] - plain[:, 0])[:, 2]
    assert across.sum() == pytest.approx(area.sum(), rel=1e-9)  # the outline stayed: a fold would cover more
    assert any("eased off" in warning for warning in moved.warnings)
    assert any("would move by more than 2 mm" in warning for warning in moved.warnings)
    assert np.abs(moved.move).max() <= 2e-3
    assert moved.moved.vertices[:, 2].max() <= 1e-12


def test_jacobians_know_a_fold() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = Mesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    pulled = square.copy()
    pulled[2] = [-0.5, -0.5, 0.0]  # over the diagonal: both facets turn over
    assert jacobians(mesh, mesh.with_vertices(pulled)) == pytest.approx([-0.5, -0.5])
    assert jacobians(mesh, mesh.with_vertices(square * 0.5)) == pytest.approx([0.25, 0.25])
    assert jacobians(mesh, mesh.with_vertices(square * [1, 1, -1] + [0, 0, 1])) == pytest.approx([1.0, 1.0])


def test_dividing_long_edges_keeps_the_surface_whole() -> None:
    mesh = Cone().mesh(5e-5)
    fine = divided(mesh, 1.25e-3)
    corners = fine.corners()
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 1.25e-3
    area = [trimesh.Trimesh(one.vertices, one.faces, process=False).area for one in (mesh, fine)]
    assert area[1] == pytest.approx(area[0], rel=1e-9)
    free = [np.linalg.norm(np.diff(one.vertices[topology(one).vertices[topology(one).free]], axis=1), axis=2).sum()
            for one in (mesh, fine)]  # fmt: skip
    assert free[1] == pytest.approx(free[0], rel=1e-9)  # an edge divided on one side alone would be open
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def job_with(folder: Path, cone: Cone, file: str | None, **changes: str) -> JobFile:
    write(cone.mesh(2e-5), folder / "cone.stl")
    text = job_for(folder / "cone.stl", process="SPIF", depth="1 mm").text + "\nspringback: {method: none}\n"
    if file is not None:
        text = text.replace("unit: mm}", f"unit: mm, accuracy_surfaces: {file}}}")
    for old, new in changes.items():
        text = text.replace(old, new)
    return JobFile(text, folder)


def test_a_part_is_planned_on_its_moved_target_and_compared_with_itself(learned: FormedParts, tmp_path: Path) -> None:
    formed_parts.save(learned, tmp_path / "m.npz")
    cone = Cone(opening=29e-3, angle=np.radians(44.0), depth=10.5e-3)
    plain, moved = plan(job_with(tmp_path, cone, None)), plan(job_with(tmp_path, cone, "m.npz"))
    assert plain.moved is None
    assert moved.moved is not None
    assert np.allclose(moved.target.z, plain.target.z, atol=1e-6)
    floor = law(np.zeros(1), np.array([cone.depth]))[0]
    deeper = min(c.forming_tip[:, 2].min() for c in plain.contours) - min(
        c.forming_tip[:, 2].min() for c in moved.contours
    )
    assert deeper == pytest.approx(floor, abs=0.06e-3)
    assert moved.plan_id != plain.plan_id
    (path,) = exports.export(moved, tmp_path / "moved.stl")
    stored = load_mesh(path, "mm")
    assert stored.vertices[:, 2].min() == pytest.approx(-cone.depth - floor, abs=0.06e-3)
    assert len(stored.faces) == len(moved.moved.moved.faces)
    (path,) = exports.export(plain, tmp_path / "plain.stl")
    assert load_mesh(path, "mm").vertices[:, 2].min() == pytest.approx(-cone.depth, abs=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("AA5754-O", "DC04", "DC04"),
        ("thickness: 1.0 mm", "thickness: 1.5 mm", "blanks of 1 mm, this one is 1.5 mm thick"),
        ("radius: 5 mm", "radius: 6 mm", "tool radius of 6.00 mm instead of"),
        ("method: none", "method: analytic", "springback method analytic instead of"),
        ("rig: ren2018", "rig: ren2018\nbacking_plate: {shape: circle, size: [90 mm, 90 mm]}", "a backing plate"),
    ],
)
def test_a_part_of_other_conditions_is_refused(
    learned: FormedParts, tmp_path: Path, old: str, new: str, what: str
) -> None:
    formed_parts.save(learned, tmp_path / "m.npz")
    with pytest.raises(IsfError, match=what) as refused:
        plan(job_with(tmp_path, CONES[0], "m.npz", **{old: new}))
    assert refused.value.code == ErrorCode.LEARNING_UNUSABLE
    assert refused.value.where.endswith("m.npz")


def test_files_come_back_and_damaged_ones_are_refused(learned: FormedParts, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    formed_parts.save(learned, path)
    back = formed_parts.load(path)
    assert back.conditions == learned.conditions
    assert back.uncertainty == pytest.approx(learned.uncertainty)
    assert all(np.array_equal(a.values, b.values) for a, b in zip(back.parts, learned.parts, strict=True))

    def refusal(file: Path) -> str:
        with pytest.raises(IsfError) as refused:
            formed_parts.load(file)
        assert refused.value.code == ErrorCode.LEARNING_UNUSABLE
        assert refused.value.advice.startswith("make it with: isf learn")
        return refused.value.what

    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert "damaged" in refusal(path) or "cannot be used" in refusal(path)
    path.write_bytes(b"")
    refusal(path)
    assert refusal(tmp_path / "none.npz") == "no such file"
    np.savez(tmp_path / "other.npz", format=np.asarray(1))
    assert "no accuracy surfaces" in refusal(tmp_path / "other.npz")
    np.savez(tmp_path / "later.npz", kind=np.asarray("accuracy surfaces"), format=np.asarray(3), predictors=np.empty(0))
    assert "another version" in refusal(tmp_path / "later.npz")
    np.savez(tmp_path / "older.npz", kind=np.asarray("accuracy surfaces"), format=np.asarray(1))
    assert "does not tell what was compensated" in refusal(tmp_path / "older.npz")


@pytest.mark.parametrize(
    ("path", "here", "plainly"),
    [
        ("compensation: [sheet]", "compensation of sheet in the plan", "compensation of nothing in the plan"),
        ("stages: [30 deg]", "stages before the part", "no stages before the part"),
        ("morph: {}", "stages before the part", "no stages before the part"),
        ("finishing_passes: 2", "2 finishing passes", "0 finishing passes"),
        ("support: on_blank", "the support tool under the blank", "the support tool opposite the contact"),
    ],
)
def test_a_part_that_is_formed_in_another_way_is_refused(
    path: str, here: str, plainly: str, learned: FormedParts, tmp_path: Path
) -> None:
    """What the plan does against springback already would be done twice; stages and passes leave another deviation."""
    write(CONES[0].mesh(2e-5), tmp_path / "cone.stl")
    text = job_for(tmp_path / "cone.stl", force="0 N").text.replace("support_force: 0 N, ", "")
    text += "\nspringback: {method: none, first_contour: zero}"
    plain = JobFile(text, tmp_path).job
    other = JobFile(text.replace("incremental_depth", f"{path}, incremental_depth", 1), tmp_path).job
    assert Conditions.of(plain).difference(Conditions.of(plain)) == ""
    file = tmp_path / "learned.npz"
    cases = (plain, other, f"{here} instead of {plainly}"), (other, plain, f"{plainly} instead of {here}")
    for made, asked, words in cases:
        formed_parts.save(replace(learned, conditions=Conditions.of(made)), file)
        with pytest.raises(IsfError) as refused:
            formed_parts.load(file).check(asked, "learned.npz")
        assert refused.value.code == ErrorCode.LEARNING_UNUSABLE
        assert refused.value.what == f"was learned under other conditions: {words}"


def test_parts_whose_floors_were_not_passed_over_teach_none_that_passes_over_its_own(
    learned: FormedParts, tmp_path: Path
) -> None:
    """A job that leaves it open was planned without passes before they came by themselves: the contours tell."""
    write(CONES[0].mesh(2e-5), tmp_path / "cone.stl")
    walls = job_for(tmp_path / "cone.stl", process="SPIF", depth="1 mm")
    by_itself = JobFile(walls.text.replace(NO_PASSES, ""), tmp_path)
    assert Conditions.of(by_itself.job, None, plan(by_itself).contours) == Conditions.of(by_itself.job)
    then = Conditions.of(by_itself.job, None, plan(walls).contours)
    assert (
        Conditions.of(by_itself.job).difference(then) == "passes over the floors instead of no passes over the floors"
    )
    for conditions in (then, Conditions.of(by_itself.job)):
        formed_parts.save(replace(learned, conditions=conditions), tmp_path / "m.npz")
        assert formed_parts.load(tmp_path / "m.npz").conditions == conditions


def test_processes_of_which_nothing_is_learned_refuse_the_field(tmp_path: Path) -> None:
    write(CONES[0].mesh(2e-5), tmp_path / "cone.stl")
    text = job_for(tmp_path / "cone.stl", process="ADSIF", force="0 N").text
    with pytest.raises(IsfError, match="accuracy_surfaces needs process SPIF or DSIF"):
        JobFile(text.replace("unit: mm}", "unit: mm, accuracy_surfaces: m.npz}"), tmp_path)
