"""The published response surface of accumulative DSIF, forwards and backwards (Ren 2018, chapter 3)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import adsif_surface
from isf_core.files.adsif_surface import AdsifSurface, choose, level_set, load_surface, stable_angle

SURFACE = load_surface("AA5754-O_1mm_R5")

PUBLISHED = {
    0.6: (None, 35.8, 37.3, 36.7),
    0.7: (31.9, 31.7, 31.9, 31.8),
    0.8: (22.4, 25.4, 27.1, 29.0),
    0.9: (18.3, 21.5, 25.4, 28.1),
    1.0: (16.5, 21.1, 24.5, 27.2),
}

LEVEL_SETS = {
    20: {25: 0.8585},
    25: {25: 0.7726, 35: 0.8103, 45: 0.9444},
    28: {25: 0.7411, 35: 0.7587, 45: 0.7812, 55: 0.9111},
    30: {25: 0.7200, 35: 0.7270, 45: 0.7396, 55: 0.7643},
    35: {35: 0.6195, 45: 0.6426, 55: 0.6347},
}


def test_the_nineteen_published_angles_are_returned_exactly() -> None:
    for gap, row in PUBLISHED.items():
        for theta, angle in zip((25, 35, 45, 55), row, strict=True):
            found = float(stable_angle(SURFACE, np.radians(theta), gap))
            if angle is None:
                assert np.isnan(found)
            else:
                assert np.degrees(found) == pytest.approx(angle, abs=1e-9)


def test_between_the_runs() -> None:
    assert np.degrees(stable_angle(SURFACE, np.radians(30), 0.75)) == pytest.approx(27.85, abs=1e-9)
    # in the cell with the buckled run only the half away from it is known
    assert np.isnan(stable_angle(SURFACE, np.radians(27), 0.62))
    assert np.degrees(stable_angle(SURFACE, np.radians(33), 0.68)) == pytest.approx(32.56, abs=1e-9)
    assert np.isnan(stable_angle(SURFACE, np.radians(40), 0.55))
    assert np.isnan(stable_angle(SURFACE, np.radians(20), 0.8))


@pytest.mark.parametrize("angle", LEVEL_SETS)
def test_level_sets(angle: int) -> None:
    """The sample inverse look-ups of Ren 2018, 3.3: linear in the gap at a fixed position angle."""
    pairs = level_set(SURFACE, np.radians(angle))
    for theta in (25, 35, 45, 55):
        found = pairs[np.abs(np.degrees(pairs[:, 0]) - theta) < 1e-6, 1]
        if theta in LEVEL_SETS[angle]:
            assert found == pytest.approx([LEVEL_SETS[angle][theta]], abs=1e-4)
        else:
            assert len(found) == 0


@settings(max_examples=15, deadline=None)
@given(st.floats(16.5, 37.3), st.sampled_from(adsif_surface.POLICIES))
def test_what_is_chosen_forms_the_angle(angle: float, policy: str) -> None:
    theta, gap = choose(SURFACE, np.radians([angle]), policy)
    # sets are looked up on a grid of 0.05 deg
    assert np.degrees(stable_angle(SURFACE, theta, gap)) == pytest.approx(angle, abs=0.06)


def test_policies_choose_what_they_say() -> None:
    angle = np.radians(np.linspace(20, 31, 23))
    chosen = {policy: choose(SURFACE, angle, policy) for policy in adsif_surface.POLICIES}
    force = {policy: np.sum(adsif_surface.tool_forces(SURFACE, *pair), axis=0) for policy, pair in chosen.items()}
    variation = {policy: adsif_surface.angle_variation(SURFACE, pair[0]) for policy, pair in chosen.items()}
    np.testing.assert_allclose(variation["variation"], np.radians(3.0), atol=1e-12)  # at 25 deg, the smallest there is
    # slack for the grid of the level sets
    assert (force["force"] <= np.min([force[p] for p in ("variation", "trade_off", "continuity")], axis=0) + 0.5).all()
    assert (variation["trade_off"] <= np.radians(5.0) + 1e-9).all()
    assert (force["trade_off"] <= force["variation"] + 0.5).all()
    jumps = {policy: np.abs(np.diff(pair[0])).max() for policy, pair in chosen.items()}
    assert jumps["continuity"] < jumps["force"]


def test_no_pair_is_quiet_enough_for_the_steepest_walls() -> None:
    """35 deg needs a position angle of 33 deg: more than 5 deg of variation, the least there is."""
    theta, _ = choose(SURFACE, np.radians([35.0]), "trade_off")
    quietest, _ = choose(SURFACE, np.radians([35.0]), "variation")
    assert theta == pytest.approx(quietest)


def test_a_wall_beyond_the_surface_is_refused() -> None:
    with pytest.raises(IsfError) as caught:
        choose(SURFACE, np.radians([20.0, 37.4]), "force")
    assert caught.value.code is ErrorCode.ADSIF_NOT_REACHABLE
    assert "37.3 deg at most" in caught.value.message


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"material": "AA1100-O"}, "material AA1100-O"),
        ({"pitch": 0.1e-3}, "pitch 0.1 mm"),
        ({"thickness": 0.5e-3}, "thickness over tool radius 0.1 "),
        ({"radii": (5e-3, 4e-3)}, "thickness over tool radius 0.25 "),
    ],
)
def test_a_surface_is_not_used_for_something_else(change: dict[str, object], reported: str) -> None:
    job = {"material": "AA5754-O", "pitch": 0.2e-3, "thickness": 1e-3, "radii": (5e-3, 5e-3)}
    adsif_surface.check_use(SURFACE, **job)  # type: ignore[arg-type]
    # the ratio counts, not the thickness
    adsif_surface.check_use(SURFACE, **(job | {"thickness": 0.8e-3, "radii": (4e-3, 4e-3)}))  # type: ignore[arg-type]
    with pytest.raises(IsfError) as caught:
        adsif_surface.check_use(SURFACE, **(job | change))  # type: ignore[arg-type]
    assert caught.value.code is ErrorCode.ADSIF_SURFACE_MISMATCH
    assert reported in caught.value.message


@pytest.mark.parametrize(
    ("theta", "exact"), [(0, 0.0018), (25, 0.0860), (35, 0.1159), (45, 0.1423), (55, 0.1644), (60, 0.1737)]
)
def test_gap_opens_under_load(theta: float, exact: float) -> None:
    """Ren 2018, 3.3.1: r = 5, gap 1.0, deflection 0.2 mm."""
    opened = adsif_surface.opened_gap(1e-3, 0.2e-3, np.radians(theta), 5e-3) - 1e-3
    assert opened * 1e3 == pytest.approx(exact, abs=0.5e-4)


@given(st.floats(0.6e-3, 1.0e-3), st.floats(0.0, 1.0e-3), st.floats(25, 55))
def test_exact_compensation_undoes_the_opening(gap: float, deflection: float, theta: float) -> None:
    commanded = adsif_surface.commanded_gap(np.array([gap]), np.array([deflection]), np.radians([theta]), 5e-3)
    assert adsif_surface.opened_gap(commanded, deflection, np.radians(theta), 5e-3)[0] == pytest.approx(gap, abs=1e-12)


def test_forces_keep_the_published_bounds() -> None:
    forming, support = adsif_surface.tool_forces(SURFACE, np.radians([25.0, 45.0, 55.0, 35.0]), [1.0, 0.6, 0.8, 0.8])
    np.testing.assert_allclose(forming, [100, 1500, 175, 175])
    assert (support <= forming).all()


def test_a_malformed_surface_is_refused() -> None:
    data = SURFACE.model_dump()
    for field, value in {"gap": [0.6, 0.8], "angle_variation": [0.1], "position_angle": [1.0, 0.9, 0.8, 0.7]}.items():
        with pytest.raises(ValueError, match="must"):
            AdsifSurface.model_validate(data | {field: value})
