"""Clusters and control points: the worked example of the source, its parts, symmetry, odd loops."""

from dataclasses import replace

import numpy as np
import pytest
from isf_planner.part_library.catalogue import fish_fin, heart
from isf_springback.database.control_points import (
    ControlPointOptions,
    control_contours,
    control_points,
    part_symmetries,
)
from isf_springback.database.feature_clusters import (
    ClusterOptions,
    calinski_harabasz,
    cluster_loop,
    k_means,
    k_medoids,
    stretches,
)
from isf_springback.database.loop_features import loop_features
from loop_parts import contour_of, pyramid_loops, rounded_square
from springback_parts import cone_contour

TOOL = 5e-3
CLAMP = (0.25, 0.25)


def clusters(contour, **options):
    features = loop_features(contour, TOOL).normalised(TOOL)
    return cluster_loop(features, ClusterOptions(shortest=8, **options))


def test_worked_example_of_calinski_harabasz():
    """Ren 2018 eq. 4-8 to 4-12 on {0, 0.1, 1.0, 1.1, 1.2}, worked by hand: 158.76 for two clusters, 133.80 for three,
    so two win; W + B is the whole scatter."""
    x = np.array([0.0, 0.1, 1.0, 1.1, 1.2])[:, None]
    assert calinski_harabasz(x, np.array([0, 0, 1, 1, 1])) == pytest.approx(158.76, abs=0.01)
    assert calinski_harabasz(x, np.array([0, 0, 1, 2, 2])) == pytest.approx(133.80, abs=0.01)
    assert cluster_loop(x, ClusterOptions(shortest=1), closed=False).tolist() == [0, 0, 1, 1, 1]


def test_cone_is_one_cluster_with_one_point():
    loops = control_points([cone_contour(k) for k in range(10)], TOOL, CLAMP)
    assert all(loop.labels.max() == 0 and len(loop.places) == 1 for loop in loops)


@pytest.mark.parametrize("corner", [15e-3, 30e-3, 40e-3])
def test_rounded_pyramid_has_four_walls_and_four_corners(corner):
    """8 stretches whose ends are those of the arcs to half the curvature window, 16 points, 3 of them different."""
    contour = contour_of(rounded_square(60e-3, corner), 5e-3)
    labels = clusters(contour)
    assert labels.max() + 1 == 8
    assert stretches(labels) == 8
    starts = contour.contact[np.flatnonzero(labels != np.roll(labels, 1)), :2]
    ends = 60e-3 - corner
    exact = np.array([[s * 60e-3, t * ends] for s in (-1, 1) for t in (-1, 1)])
    exact = np.vstack([exact, exact[:, ::-1]])
    distance = np.linalg.norm(starts[:, None] - exact[None], axis=2)
    assert distance.min(axis=1).max() < 0.7 * TOOL
    assert sorted(distance.argmin(axis=1)) == [*range(8)]


def test_sharp_pyramid_has_its_corners_as_clusters():
    contour = contour_of(rounded_square(60e-3, 0.0), 5e-3)
    labels = clusters(contour)
    assert labels.max() + 1 == 8
    corners = np.abs(np.abs(contour.contact[:, :2]) - 60e-3).max(axis=1) < 0.3e-3
    sides = np.abs(contour.contact[:, :2]).min(axis=1) < 1e-3
    assert len(set(labels[corners])) == 4
    assert not set(labels[corners]) & set(labels[sides])


def test_k_means_mixes_places_that_ward_keeps_apart():
    """The comparison of the source: without neighbourhood one label is spread over all corners."""
    contour = contour_of(rounded_square(60e-3, 30e-3), 5e-3)
    features = loop_features(contour, TOOL).normalised(TOOL)
    ward, means = clusters(contour), k_means(features, 8)
    assert stretches(ward) == ward.max() + 1 == 8
    assert stretches(means) > 8


def test_k_medoids_finds_the_best_middles_and_mixes_places_too():
    features = np.array([0.0, 0.1, 0.2, 1.0, 1.1, 5.0, 5.1])[:, None]
    assert k_medoids(features, 3).tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert k_medoids(features, 1).tolist() == [0] * 7
    contour = contour_of(rounded_square(60e-3, 0.0), 5e-3)
    curvature = loop_features(contour, TOOL).normalised(TOOL)
    found = k_medoids(curvature, 8)
    assert stretches(clusters(contour)) == 8
    assert stretches(found) > 8  # the four corners share labels: no place of its own for each


@pytest.mark.parametrize("inwards", [0.5e-3, 5e-3, 10e-3])
def test_short_straights_of_the_heart_are_stretches_of_their_own(inwards):
    """Two straights of 4 to 6 mm between convex and concave arcs, shorter than the window of the curvature (10 mm)."""
    part = heart()
    ring = part.features[0].levels.ring(inwards, 1e-6, (inwards, inwards)) - part.origin
    contour = contour_of(ring, 5e-3)
    labels, curvature = clusters(contour), loop_features(contour, TOOL).curvature
    assert labels.max() + 1 == len(part.features[0].levels.line.curvature) == 8
    length = np.bincount(labels) * 0.5e-3
    short = np.flatnonzero(length < 6.1e-3)
    assert len(short) == 2
    assert all(abs(np.median(curvature[labels == k])) * TOOL < 0.06 for k in short)


@pytest.mark.parametrize("make", [fish_fin, heart], ids=["fish fin", "heart"])
def test_parts_of_the_source_show_their_arcs(make):
    """Every stretch has the curvature of one arc or straight of the outline, convex and concave ones told apart."""
    part = make()
    inwards = 5e-3
    ring = part.features[0].levels.ring(inwards, 1e-6, (inwards, inwards)) - part.origin
    contour = contour_of(ring, 5e-3)
    curvature = loop_features(contour, TOOL).curvature
    labels = clusters(contour)
    pieces = part.features[0].levels.line
    exact = pieces.curvature / (1.0 - inwards * pieces.curvature)
    found = np.array([np.median(curvature[labels == k]) for k in range(labels.max() + 1)])
    # stretches shorter than the window of the curvature (one tool diameter) are seen blurred
    long = np.array([(labels == k).sum() * 0.5e-3 > 3 * TOOL for k in range(labels.max() + 1)])
    assert np.abs(found[long, None] - exact).min(axis=1).max() * TOOL < 0.02
    assert stretches(labels) == labels.max() + 1
    assert (found * TOOL < -0.15).sum() == (exact < 0).sum() == 1
    assert (found * TOOL > 0.15).sum() == (exact * TOOL > 0.15).sum()


def test_rounded_pyramid_needs_few_points():
    """Three thousand path points and more; 3 computed points on each of the 19 loops that still have corners."""
    contours = pyramid_loops(corner=40e-3, depth=19e-3)
    assert sum(len(contour) for contour in contours) > 3000
    loops = control_points(contours, TOOL, CLAMP)
    assert all(loop.central.sum() == 8 for loop in loops)
    assert sum(len(loop.computed) for loop in loops) < 60
    for loop in loops:
        mirrored = np.sort(np.abs(loop.points[:, :2]), axis=1)
        own = np.sort(np.abs(loop.points[loop.same_as, :2]), axis=1)
        assert np.linalg.norm(mirrored - own, axis=1).max() < TOOL
        assert (loop.central == loop.central[loop.same_as]).all()


def test_symmetry_is_that_of_part_and_clamp():
    square = [contour_of(rounded_square(60e-3, 30e-3), 5e-3)]
    assert len(part_symmetries(square, CLAMP, 0.2e-3)) == 7
    assert len(part_symmetries(square, (0.25, 0.20), 0.2e-3)) == 3
    off_centre = [contour_of(rounded_square(60e-3, 30e-3) + [3e-3, 0.0], 5e-3)]
    assert len(part_symmetries(off_centre, CLAMP, 0.2e-3)) == 1
    oblique = [contour_of(rounded_square(60e-3, 30e-3) @ np.array([[0.8, -0.6], [0.6, 0.8]]) + [3e-3, 2e-3], 5e-3)]
    assert part_symmetries(oblique, CLAMP, 0.2e-3) == []


def test_control_contours_are_a_depth_apart_and_hold_the_last():
    contours = pyramid_loops(depth=7e-3, step=0.5e-3)
    assert control_contours(contours, 1e-3) == [1, 3, 5, 7, 9, 11, 13]
    assert control_contours(contours[:4], 1.4e-3) == [2, 3]
    in_turn = [replace(contour, feature=feature) for contour in contours[:6] for feature in (0, 1)]
    assert control_contours(in_turn, 1e-3) == [2, 3, 6, 7, 10, 11]


def test_number_of_clusters_can_be_asked_for():
    contour = contour_of(rounded_square(60e-3, 30e-3), 5e-3)
    assert clusters(contour, count=4).max() + 1 == 4
    few = control_points([contour], TOOL, CLAMP, ControlPointOptions(most_clusters=2))
    assert len(few[0].places) <= 4


def test_across_curvature_can_be_a_feature():
    contours = pyramid_loops(depth=3e-3)
    loops = control_points(contours, TOOL, CLAMP, ControlPointOptions(across=True))
    assert [len(loop.places) for loop in loops] == [16, 16, 16]
