"""Rotations between frames: against products made by hand, in any order of arrival; what is missing, old or wrong."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.geometry.frame_tree import FrameTree
from scipy.spatial.transform import Rotation, Slerp

NONE = (0.0, 0.0, 0.0, 1.0)
ABOUT_Z = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
ABOUT_X = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def refused(tree: FrameTree, base: str, frame: str) -> str:
    with pytest.raises(IsfError) as caught:
        tree.rotation(base, frame)
    assert caught.value.code == ErrorCode.POSE_LOST
    return caught.value.what


def test_a_robot_in_the_room_and_the_sheet_beside_it() -> None:
    """world - base - flange - cell and world - sheet: base turned 90 degrees about z, flange about its own x."""
    tree = FrameTree(1.0, Clock())
    assert tree.add("flange", "cell", NONE, fixed=True)
    assert tree.add("base", "flange", ABOUT_X)
    assert tree.add("world", "sheet", NONE, fixed=True)
    assert tree.add("world", "base", ABOUT_Z, fixed=True)
    turn = tree.rotation("sheet", "cell")
    # y of the cell is z of the base, which is up; z of the cell is -y of the base, which is x of the room
    np.testing.assert_allclose(turn.matrix @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(turn.matrix @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-12)
    assert turn.links == {"cell", "flange", "base", "sheet"}
    assert tree.rotation("flange", "cell").links == {"cell"}  # what is above both does not matter
    np.testing.assert_array_equal(tree.rotation("cell", "cell").matrix, np.eye(3))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 12))
def test_every_pair_of_frames_of_a_tree(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    parents = [int(random.integers(0, k)) for k in range(1, count)]
    turns = Rotation.from_quat(random.standard_normal((count - 1, 4)))
    tree = FrameTree(1.0, Clock())
    for k in random.permutation(count - 1):
        assert tree.add(f"f{parents[k]}", f"f{k + 1}", turns[int(k)].as_quat())
    in_room = [np.eye(3)]
    for k, parent in enumerate(parents):
        in_room.append(in_room[parent] @ turns[k].as_matrix())
    for base in range(count):
        for frame in range(count):
            expected = in_room[base].T @ in_room[frame]
            np.testing.assert_allclose(tree.rotation(f"f{base}", f"f{frame}").matrix, expected, atol=1e-12)


def test_what_changes_grows_old_and_what_is_fixed_does_not() -> None:
    clock = Clock()
    tree = FrameTree(0.5, clock)
    tree.add("sheet", "base", NONE, fixed=True)
    tree.add("base", "wrist", NONE)
    clock.now += 0.3
    tree.add("wrist", "flange", NONE)
    assert tree.rotation("sheet", "flange").until == pytest.approx(100.5)  # the oldest one on the way
    clock.now += 0.3
    assert "'wrist' stands in 'base' is more than 0.5 s old" in refused(tree, "sheet", "flange")
    tree.rotation("wrist", "flange")
    clock.now += 1e6
    assert tree.rotation("sheet", "base").until == math.inf
    tree.add("base", "wrist", ABOUT_Z)
    tree.add("wrist", "flange", NONE)
    np.testing.assert_allclose(tree.rotation("sheet", "flange").matrix @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_what_does_not_hang_together_is_named() -> None:
    tree = FrameTree(1.0, Clock())
    assert "nothing is known of frame 'flange' and 'sheet'" in refused(tree, "sheet", "flange")
    tree.add("base", "flange", NONE)
    assert "nothing is known of frame 'sheet'" in refused(tree, "sheet", "flange")
    tree.add("world", "sheet", NONE, fixed=True)
    assert "'flange' hangs below 'base', 'sheet' below 'world'" in refused(tree, "sheet", "flange")
    tree.add("world", "base", NONE, fixed=True)
    tree.rotation("sheet", "flange")
    tree.add("flange", "world", NONE)  # somebody publishes the chain the other way round, too
    assert "form a ring" in refused(tree, "sheet", "flange")


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0)])
def test_what_is_no_rotation_is_not_taken(turn: tuple[float, ...]) -> None:
    tree = FrameTree(1.0, Clock())
    tree.add("sheet", "tool", ABOUT_Z)
    assert not tree.add("sheet", "tool", turn)
    np.testing.assert_allclose(tree.rotation("sheet", "tool").matrix @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


# -- at the moment of a stamp ------------------------------------------------------------------------


def about_z(angle: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle))


def x_points(tree: FrameTree, stamp: float) -> float:
    """Angle in rad of x of "flange" in "sheet" about z."""
    x, y, z = tree.rotation_at("sheet", "flange", stamp).matrix @ [1.0, 0.0, 0.0]
    assert abs(z) < 1e-12
    return math.atan2(y, x)


def test_between_two_transforms_the_axes_turn_evenly_and_after_the_last_they_stay() -> None:
    tree = FrameTree(0.5, Clock())
    tree.add("room", "sheet", about_z(-1.0), fixed=True)
    for stamp, angle in ((10.0, 0.0), (10.1, 0.2), (10.2, 0.6)):
        tree.add("room", "flange", about_z(angle), stamp=stamp)
    for stamp, angle in ((10.0, 0.0), (10.05, 0.1), (10.1, 0.2), (10.175, 0.5), (10.2, 0.6), (10.6, 0.6), (9.6, 0.0)):
        assert x_points(tree, stamp) == pytest.approx(angle + 1.0, abs=1e-12)
    for stamp, words in ((10.71, "0.51 s older than"), (9.4, "0.60 s newer than")):
        with pytest.raises(IsfError) as caught:
            tree.rotation_at("sheet", "flange", stamp)
        assert caught.value.code == ErrorCode.POSE_LOST
        assert f"'flange' stands in 'room' was measured {words} the reading, 0.5 s are allowed" in caught.value.what
    held = tree.rotation_at("sheet", "flange", 10.3)
    assert (held.since, held.until) == (10.2, pytest.approx(10.7))
    between = tree.rotation_at("sheet", "flange", 10.15)
    assert (between.since, between.until) == (10.15, 10.15)
    assert tree.rotation_at("room", "sheet", 1e6).until == math.inf
    # what was measured at the same moment replaces; a clock that is set back begins anew
    tree.add("room", "flange", about_z(0.8), stamp=10.2)
    assert x_points(tree, 10.3) == pytest.approx(1.8)
    tree.add("room", "flange", about_z(0.3), stamp=2.0)
    assert x_points(tree, 2.1) == pytest.approx(1.3)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_chain_of_moving_links_against_slerp(seed: int) -> None:
    """Each link with stamps of its own, some moving up the tree and some down, against scipy's Slerp and products."""
    random = np.random.default_rng(seed)
    names = ["sheet", "a", "room", "b", "flange"]
    tree, paths = FrameTree(1.0, Clock()), []
    for below, above in pairwise(names):
        child, parent = (below, above) if above in ("a", "room") else (above, below)
        times = np.cumsum(random.uniform(0.01, 0.1, 8))
        turns = Rotation.from_quat(random.standard_normal((8, 4)))
        for moment, turn in zip(times, turns, strict=True):
            tree.add(parent, child, turn.as_quat(), stamp=float(moment))
        paths.append((times, turns, child == below))
    stamp = float(random.uniform(0.0, 0.6))
    whole = Rotation.identity()
    for times, turns, inverse in paths:
        turn = Slerp(times, turns)([min(max(stamp, times[0]), times[-1])])[0]
        whole = whole * (turn.inv() if inverse else turn)
    found = tree.rotation_at("sheet", "flange", stamp)
    np.testing.assert_allclose(found.matrix, whole.as_matrix(), atol=1e-9)
    assert found.since <= stamp <= found.until


def test_old_samples_go() -> None:
    tree = FrameTree(100.0, Clock())
    for k in range(1000):
        tree.add("sheet", "flange", about_z(1e-3 * k), stamp=0.01 * k)
    assert x_points(tree, 0.0) == pytest.approx(1e-3 * 899)  # 1 s before the newest
