"""Rotations between frames: against products made by hand, in any order of arrival; what is missing, old or wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_load_cell.frame_tree import FrameTree
from scipy.spatial.transform import Rotation

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
