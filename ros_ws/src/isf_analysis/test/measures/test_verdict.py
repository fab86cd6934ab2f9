"""A part is good only when it is; else the headline says what it falls short of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from isf_analysis.measures.contour_scan import kept_scan
from isf_analysis.measures.deviation import regions_of
from isf_analysis.measures.record import PartRecord
from isf_analysis.measures.summary import summary
from isf_analysis.measures.verdict import force_remarks, verdict
from isf_analysis.report.result_tables import banners, cards
from isf_core.contour import ContourCorrection
from isf_core.errors import ErrorCode
from isf_core.events import Event, EventKind
from isf_core.geometry.height_map import HeightMap
from synthetic_part import make_part

PART = make_part(contours=6, spacing=2.5e-3)
assert PART.target is not None
EXACT = replace(PART, scan=PART.target)


def off_by(error: float, part: PartRecord = EXACT) -> PartRecord:
    """``part`` with all of its shape ``error`` m too high."""
    target = part.target
    assert target is not None
    return replace(part, scan=HeightMap(target.x, target.y, target.z + error))


def without_contact() -> PartRecord:
    """Exact, position controlled, and the support tool without a force at every second point."""
    part = make_part(spacing=2.5e-3, contours=3, support_force=0.0)
    results = []
    for result in part.results:
        force = result.support_force.copy()
        force[::2] = 0.0
        results.append(replace(result, support_force=force))
    return replace(part, results=tuple(results), scan=part.target)


def reported(part: PartRecord) -> list[str]:
    numbers = summary(part)
    assert numbers["verdict"]["good"] == (not numbers["verdict"]["short_of"])
    return list(numbers["verdict"]["short_of"])


def test_a_part_without_a_flaw_is_good_and_its_headline_green() -> None:
    assert reported(EXACT) == []
    assert 'class="banner good"' in banners(summary(EXACT), has_reference=True)
    assert reported(off_by(0.29e-3)) == []


FLAWS = {
    "tolerance": (off_by(0.31e-3), "error out of tolerance: 0 % of the points"),
    "not corrected": (
        off_by(0.31e-3, replace(EXACT, correction="none", corrections=())),
        "springback was not corrected",
    ),
    "no scan": (replace(EXACT, scan=None), "the shape was not measured"),
    "torn": (
        replace(EXACT, events=(Event(EventKind.GALLING, 1.0, (0.0, 0.0, 0.0), 210.0, 200.0, "the tool galls"),)),
        "galling, 1 times: the tool galls",
    ),
    "no contact": (without_contact(), "contact lost: the support tool is under position control"),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_flaw_takes_the_green_away_and_is_named(flaw: str) -> None:
    part, words = FLAWS[flaw]
    assert any(text.startswith(words) for text in reported(part)), reported(part)
    page = banners(summary(part), has_reference=True)
    assert 'class="banner good"' not in page
    assert "Part complete, but not good" in page


def test_the_tolerance_of_the_job_decides() -> None:
    part = off_by(0.31e-3)
    assert any("within 0.3 mm, 90 % are wanted" in text for text in reported(part))
    assert reported(replace(part, job_text="tolerance: {shape: 0.32 mm}\n")) == []
    strict = reported(replace(off_by(0.05e-3), job_text="tolerance: {shape: 0.04 mm, share: 0.95}\n"))
    assert any("0 % of the points are within 0.04 mm, 95 % are wanted" in text for text in strict)


def test_a_floor_that_no_tool_passed_over_is_named_with_what_would_help() -> None:
    """Only where the floor is the worse place, and was not passed over."""
    target = EXACT.target
    assert target is not None
    raised = target.z + 0.5e-3 * regions_of(target)["base"]
    numbers = summary(replace(EXACT, scan=HeightMap(target.x, target.y, raised)))
    words = "floor: 0 % of its points are within 0.3 mm, and no tool passed over it; path.floor_step plans that"
    assert any(text.startswith(words) for text in numbers["verdict"]["short_of"]), numbers["verdict"]
    for other in ({**numbers, "floor_passes": 2}, {**numbers, "process": "ADSIF"}, summary(off_by(0.31e-3))):
        assert not any(text.startswith("floor") for text in verdict(other)["short_of"])


TEXTS = {
    "": "",
    "- a list\n": "",
    "12": "",
    "name: cone\n": "",
    "tolerance: {}\n": "",
    "name: [": "expected the node content",
    "tolerance: 3\n": "is empty or not a mapping",
    "tolerance: {shape: -1 mm}\n": "shape: ",
    "tolerance: {shap: 1 mm}\n": "unknown field 'shap'",
}


@pytest.mark.parametrize("text", TEXTS)
def test_a_job_without_a_tolerance_that_can_be_read_has_the_published_one_and_a_wrong_one_is_noted(text: str) -> None:
    part, why = replace(EXACT, job_text=text), TEXTS[text]
    assert (part.tolerance.shape, part.tolerance.share) == (0.3e-3, 0.9)
    notes = [note for note in summary(part)["notes"] if note.startswith("tolerance of the job cannot be read")]
    assert len(notes) == bool(why)
    assert all(why in note and note.endswith("; 0.3 mm, 90 % are used") for note in notes)


def test_all_points_wanted_means_all_of_them() -> None:
    target = EXACT.target
    assert target is not None
    z = target.z.copy()
    z[len(target.y) // 2, len(target.x) // 2] += 0.5e-3
    job = "tolerance: {share: 1.0}\n"
    one_off = replace(EXACT, scan=HeightMap(target.x, target.y, z), job_text=job)
    (text,) = [text for text in reported(one_off) if "out of tolerance" in text]
    assert "100 % of the points are within" not in text
    assert reported(replace(EXACT, job_text=job)) == []


def test_a_force_out_of_its_band_is_a_red_card_and_a_note_and_leaves_a_part_good() -> None:
    """2 % of the controlled time 11 N beside the set-point, in contact all the time."""
    results = []
    for result in EXACT.results:
        force = np.where(result.tick_engaged, result.tick_set_point, result.tick_normal_force)
        force[::50] += 11.0
        results.append(replace(result, tick_normal_force=force))
    part = replace(EXACT, results=tuple(results))
    assert reported(part) == []
    numbers = summary(part)
    (text,) = numbers["notes"]
    assert text.startswith("force out of band: the support force is within 10 N of its set-point in 97.9 %")
    assert '<div class="card bad"><div class="label">Within ± 10 N' in cards(numbers)
    assert summary(EXACT)["notes"] == []


def test_a_share_that_falls_short_does_not_read_as_the_wanted_one() -> None:
    """Of 98.96 %."""
    (band,) = force_remarks({"within_10N_fraction": 0.9896})
    assert "in 98.9 % of the controlled time, 99 % are wanted" in band
    numbers = summary(EXACT)
    numbers["force"]["contact_fraction"] = 0.9896
    (contact,) = verdict(numbers)["short_of"]
    assert "touched the sheet in 98.9 % of the controlled time" in contact


def test_what_the_plan_warned_of_is_told_and_leaves_a_part_good() -> None:
    part = replace(EXACT, plan_warnings=("walls of 62 deg <at x = 1.0 mm>",))
    numbers = summary(part)
    assert reported(part) == []
    assert numbers["plan_warnings"] == ["walls of 62 deg <at x = 1.0 mm>"]
    assert "The plan warned</strong>" in banners(numbers, has_reference=True)
    assert "walls of 62 deg &lt;at x = 1.0 mm&gt;." in banners(numbers, has_reference=True)


def test_a_part_beyond_what_its_machine_bears_is_complete_and_not_good() -> None:
    beyond = replace(EXACT.results[1], code=int(ErrorCode.FORCE_LIMIT), message="tool 1 took 2560 N in z")
    part = replace(EXACT, results=(EXACT.results[0], beyond, *EXACT.results[2:]))
    assert reported(EXACT) == []
    assert reported(part) == ["force: contour 2: tool 1 took 2560 N in z"]
    numbers = summary(part)
    assert (numbers["complete"], numbers["verdict"]["good"]) == (True, False)
    assert not any("2560" in note for note in numbers["notes"])  # told once


def test_a_correction_that_failed_is_reported_even_of_a_part_in_tolerance() -> None:
    failed = ContourCorrection(
        EXACT.plan_id,
        2,
        "fused",
        np.zeros((4, 3)),
        np.zeros(4),
        code=int(ErrorCode.SCAN_MISSING),
        message="no scan came",
    )
    assert reported(replace(EXACT, corrections=(failed,))) == ["not corrected: 1320: no scan came"]


@pytest.mark.parametrize(("kinetic", "good"), [(0.0003, True), (0.0199, True), (0.021, False), (0.059, False)])
def test_a_sheet_that_was_formed_too_fast_gives_no_green(kinetic: float, good: bool) -> None:
    """Its kinetic energy may be 2 % of the plastic work."""
    numbers = summary(replace(EXACT, sheet={"model": "shell_coarse", "kinetic_over_plastic": kinetic}))
    assert numbers["verdict"]["good"] is good
    shown = banners(numbers, has_reference=True)
    assert ('class="banner good"' in shown) is good
    told = f"Forces and shape carry inertia: the kinetic energy of the simulated sheet rose to {100 * kinetic:.1f} %"
    assert (told in shown) is not good


def test_the_headline_names_exact_scans() -> None:
    """The finished part of a simulated machine always has one; between contours where the job or the variant say so."""
    simulated = replace(EXACT, variant=0, sheet={"model": "shell"})
    points = np.zeros((3, 3))
    scanned = replace(simulated, scans=(kept_scan(2, 1.0, points),), correction="fused")

    def headline(part: PartRecord) -> str:
        return banners(summary(part), has_reference=True).split("</div>")[0]

    assert "in tolerance (exact scan of the finished part: no errors" in headline(simulated)
    assert "exact" not in headline(replace(simulated, variant=-1, sheet={}))
    both = "exact scan of the finished part and between contours"
    assert both in headline(scanned)
    assert both not in headline(replace(scanned, correction="none"))
    assert both not in headline(replace(scanned, variant=21))
    for variant, sensor in ((0, True), (21, True), (0, False), (21, False), (101, False)):
        text = f"{PART.job_text}\nspringback: {{scan_sensor: {str(sensor).lower()}}}\n"
        assert (both in headline(replace(scanned, variant=variant, job_text=text))) is not sensor


@pytest.mark.parametrize(("model", "kind"), [("fast", "info"), ("shell_coarse", "good"), (None, "good")])
def test_the_fast_sheet_gives_no_green(model: str | None, kind: str) -> None:
    numbers = summary(replace(EXACT, sheet={"model": model} if model else {}))
    shown = banners(numbers, has_reference=True)
    assert [word for word in ("info", "good", "warn", "bad") if f'class="banner {word}"' in shown] == [kind]
    assert ("on the fast sheet" in shown) == (model == "fast")
    assert ("shell_coarse" in numbers["verdict"]["proviso"]) == (model == "fast")


def test_a_part_that_ended_early_is_not_good() -> None:
    numbers = summary(make_part(spacing=2.5e-3, contours=5, stop_after=3))
    assert not numbers["verdict"]["good"]
    assert numbers["verdict"]["short_of"] == [numbers["failure"]["message"]]


def seen_in_part(**holes: float) -> PartRecord:
    """EXACT, of which that share of each region was not measured: the cells farthest along x."""
    target = EXACT.target
    assert target is not None
    z, masks = target.z.copy(), regions_of(target)
    for region, share in holes.items():
        rows, columns = np.nonzero(masks[region])
        order = np.argsort(-target.x[columns], kind="stable")[: round(share * len(rows))]
        z[rows[order], columns[order]] = np.nan
    return replace(EXACT, scan=HeightMap(target.x, target.y, z))


def test_a_part_that_was_hardly_measured_is_not_good() -> None:
    """What was seen is exact, all of it."""
    part = seen_in_part(wall_and_base=0.95)
    numbers = summary(part)
    assert numbers["deviation"]["regions"]["wall_and_base"]["within_tolerance_fraction"] == 1.0
    (text,) = reported(part)
    assert text.startswith("not enough measured to call it good: the scan shows ")
    for name, words in (("wall_and_base", "wall and base"), ("wall", "the wall"), ("base", "the base")):
        share = numbers["deviation"]["regions"][name]["coverage"]
        assert share < 0.1
        assert f"{np.floor(1000 * share) / 10:g} % of {words}" in text
    assert text.endswith("90 % of each region are wanted")
    page = banners(numbers, has_reference=True)
    assert f"Part complete, but not good</strong>6 of 6 contours formed. N{text[1:]}" in page
    assert 'class="card good"><div class="label">Largest error' not in cards(numbers)
    assert 'class="card good"><div class="label">Largest error' in cards(summary(EXACT))


@pytest.mark.parametrize("region", ["wall", "base"])
def test_wall_and_base_are_judged_each(region: str) -> None:
    """A base of which nothing was seen, and a wall of which a third was not."""
    (text,) = reported(seen_in_part(**{region: 1.0 if region == "base" else 0.35}))
    assert f"% of the {region}" in text
    assert f"% of the {'base' if region == 'wall' else 'wall'}" not in text


def test_the_limit_is_nine_tenths_of_every_region_that_the_part_has() -> None:
    numbers = summary(EXACT)
    regions = numbers["deviation"]["regions"]
    for name in ("wall_and_base", "wall", "base"):
        for share, good in ((1.0, True), (0.9, True), (0.899, False), (0.0, False), (None, True)):
            regions[name]["coverage"] = share
            assert verdict(numbers)["good"] is good, (name, share)
        regions[name]["coverage"] = 1.0


def test_what_was_hardly_measured_and_is_out_of_tolerance_is_told_as_both() -> None:
    part = seen_in_part(wall_and_base=0.95)
    assert part.scan is not None
    texts = reported(replace(part, scan=HeightMap(part.scan.x, part.scan.y, part.scan.z + 1e-3)))
    assert [text.split(":")[0] for text in texts[:2]] == [
        "error out of tolerance",
        "not enough measured to call it good",
    ]


def test_of_holes_in_the_target_nothing_can_be_measured() -> None:
    target = EXACT.target
    assert target is not None
    z = target.z.copy()
    middle = len(target.y) // 2
    z[middle - 3 : middle + 4, middle - 3 : middle + 4] = np.nan  # of the base
    holed = HeightMap(target.x, target.y, z)
    numbers = summary(replace(EXACT, target=holed, scan=target))
    assert [numbers["deviation"]["regions"][name]["coverage"] for name in ("wall_and_base", "base")] == [1.0, 1.0]
    assert numbers["verdict"]["good"]
