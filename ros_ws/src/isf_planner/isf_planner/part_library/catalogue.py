"""The parts of the library: shapes that the field forms to test paths, forces and corrections.

The shapes are those of the literature (cone, funnel, pyramid, fish fin, heart and shamrock: Ren 2018; two-slope
pyramid and airfoil: Behera 2015; asymmetric cone: Lu 2016; free form F1 with F2 on its floor: Praveen 2020; marker,
mask, implant and bonnet: Torrao 2013, with pictures of the last three). Their full dimensions are not published: those
here are our own, for tools of up to 5 mm radius. Lengths m, angles rad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from isf_planner.part_library.arc_chain import belt, rounded_polygon
from isf_planner.part_library.part import Feature, ObliqueCircle, OffsetLine, Part, RoundedSquare
from isf_planner.part_library.wall_profile import curved_wall, straight_wall, wall

FLANGE = 8e-3


def cone(
    radius: float = 36e-3, angle: float = np.radians(50), depth: float = 21e-3, entry: float = 6e-3, floor: float = 8e-3
) -> Part:
    """Truncated cone; ``radius`` is where the extended wall meets the sheet."""
    opening = OffsetLine(belt([[0.0, 0.0]], [radius]))
    return Part("cone", (Feature(opening, straight_wall(angle, depth, entry, floor)),), FLANGE)


def funnel(
    radius: float = 42e-3,
    first_angle: float = np.radians(60),
    last_angle: float = np.radians(30),
    depth: float = 24e-3,
    entry: float = 6e-3,
    floor: float = 8e-3,
) -> Part:
    """Round part whose wall angle changes along the depth from ``first_angle`` to ``last_angle``."""
    opening = OffsetLine(belt([[0.0, 0.0]], [radius]))
    return Part("funnel", (Feature(opening, curved_wall(first_angle, last_angle, depth, entry, floor)),), FLANGE)


def pyramid(
    half_side: float = 40e-3,
    corner: float = 22e-3,
    angle: float = np.radians(50),
    depth: float = 20e-3,
    entry: float = 6e-3,
    floor: float = 8e-3,
) -> Part:
    """Square pyramid with rounded corners; ``half_side`` and ``corner`` where the extended wall meets the sheet."""
    line = rounded_polygon(half_side * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]), np.full(4, corner))
    return Part("pyramid", (Feature(OffsetLine(line), straight_wall(angle, depth, entry, floor)),), FLANGE)


def two_slope_pyramid(
    half_side: float = 52e-3,
    corner: float = 36e-3,
    upper_angle: float = np.radians(55),
    lower_angle: float = np.radians(25),
    upper_length: float = 12e-3,
    lower_length: float = 8e-3,
) -> Part:
    """Pyramid whose wall has two slopes joined by a fillet; lengths along the straight walls."""
    line = rounded_polygon(half_side * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]), np.full(4, corner))
    profile = wall([upper_angle, lower_angle], [6e-3, 10e-3, 10e-3], [upper_length, lower_length], 0.0)
    return Part("two_slope_pyramid", (Feature(OffsetLine(line), profile),), FLANGE)


def ribbed_pyramid(
    half_side: float = 55e-3,
    upper_angle: float = np.radians(60),
    upper_depth: float = 20e-3,
    lower_angle: float = np.radians(25),
    lower_depth: float = 12e-3,
    rib: float = 9e-3,
    entry: float = 4e-3,
    transition: float = 8e-3,
    floor: float = 7e-3,
) -> Part:
    """Pyramid of two slopes whose walls are planes to their ribs, which have the radius ``rib`` seen from above.

    ``half_side`` and the depths are those of the planes, extended to where they meet.
    """
    angles, radii = [upper_angle, lower_angle], [entry, transition, floor]
    turns = np.abs(np.diff([0.0, upper_angle, lower_angle, 0.0]))
    tangent = np.array(radii) * np.tan(turns / 2.0)
    lengths = np.array([upper_depth / np.sin(upper_angle), lower_depth / np.sin(lower_angle)])
    straight = lengths - tangent[:-1] - tangent[1:]
    profile = wall(angles, radii, [float(length) for length in straight], -float(tangent[0]))
    return Part("ribbed_pyramid", (Feature(RoundedSquare(half_side, rib), profile),), FLANGE)


def asymmetric_cone(
    radius: float = 40e-3,
    steepest: float = np.radians(52),
    flattest: float = np.radians(38),
    depth: float = 16e-3,
    entry: float = 8e-3,
    floor: float = 14e-3,
) -> Part:
    """Oblique cone: the wall angle goes from ``steepest`` in +x to ``flattest`` in -x."""
    short, long = 1.0 / np.tan(steepest), 1.0 / np.tan(flattest)
    shift = (long - short) / (long + short)
    profile = straight_wall(float(np.arctan(2.0 / (long + short))), depth, entry, floor)
    return Part("asymmetric_cone", (Feature(ObliqueCircle(radius, (shift, 0.0)), profile),), FLANGE).centred()


def fish_fin(angle: float = np.radians(50), depth: float = 10e-3) -> Part:
    """A swept, rounded triangle with one hollow side."""
    centres = np.array([[-22, -14], [34, -18], [36, 20], [-6, 40], [-22, 26]]) * 1e-3
    line = belt(centres, np.array([18, 18, -14, 18, 18]) * 1e-3)
    return Part("fish_fin", (Feature(OffsetLine(line), straight_wall(angle, depth, 6e-3, 6e-3)),), FLANGE).centred()


def heart(angle: float = np.radians(45), depth: float = 9e-3) -> Part:
    """Two lobes, a point and a cleft."""
    centres = np.array([[0, -26], [22, 12], [0, 42], [-22, 12]]) * 1e-3
    line = belt(centres, np.array([18, 23, -14, 23]) * 1e-3)
    return Part("heart", (Feature(OffsetLine(line), straight_wall(angle, depth, 6e-3, 6e-3)),), FLANGE).centred()


def shamrock(angle: float = np.radians(45), depth: float = 9e-3, leaf: float = 20e-3) -> Part:
    """Three leaves of radius ``leaf`` with hollows between them."""
    turn = np.radians(90 + 120 * np.arange(3))
    leaves = 26e-3 * np.column_stack([np.cos(turn), np.sin(turn)])
    hollows = 38e-3 * np.column_stack([np.cos(turn + np.pi / 3), np.sin(turn + np.pi / 3)])
    centres = np.stack([leaves, hollows], axis=1).reshape(-1, 2)
    line = belt(centres, np.tile([leaf, -13e-3], 3))
    return Part("shamrock", (Feature(OffsetLine(line), straight_wall(angle, depth, 6e-3, 6e-3)),), FLANGE).centred()


def airfoil_ridge(first_angle: float = np.radians(42), last_angle: float = np.radians(12), depth: float = 7e-3) -> Part:
    """A long ridge with the outline of an airfoil; its wall flattens towards the crown."""
    # nose, tail, and the back between them as an arc of large radius
    line = belt(np.array([[-36, 0], [44, -6], [-14, -28]]) * 1e-3, np.array([28, 20, 60]) * 1e-3)
    profile = curved_wall(first_angle, last_angle, depth, 6e-3, 10e-3)
    return Part("airfoil_ridge", (Feature(OffsetLine(line), profile),), FLANGE).centred()


def l_shape(angle: float = np.radians(45), depth: float = 10e-3) -> Part:
    """An L with one reentrant corner."""
    corners = np.array([[-45, -45], [45, -45], [45, 0], [0, 0], [0, 45], [-45, 45]]) * 1e-3
    line = rounded_polygon(corners, np.array([20, 20, 20, 14, 20, 20]) * 1e-3)
    return Part("l_shape", (Feature(OffsetLine(line), straight_wall(angle, depth, 6e-3, 6e-3)),), FLANGE).centred()


def star(points: int = 5, angle: float = np.radians(45), depth: float = 8e-3) -> Part:
    """A star with rounded points and hollows."""
    turn = np.pi / 2 + np.pi / points * np.arange(2 * points)
    reach = np.tile([66e-3, 38e-3], points)
    corners = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    line = rounded_polygon(corners, np.tile([16e-3, 16e-3], points))
    return Part("star", (Feature(OffsetLine(line), straight_wall(angle, depth, 6e-3, 6e-3)),), FLANGE).centred()


def free_form(
    scale: float = 1.0, angle: float = np.radians(45), depth: float = 15e-3, second_depth: float = 8e-3
) -> Part:
    """F1 with an irregular opening (convex and concave) and F2, a cone that rises from its floor."""
    centres = scale * np.array([[-30, -24], [34, -28], [40, 22], [2, 66], [-34, 20]]) * 1e-3
    first = belt(centres, scale * np.array([30, 28, 28, -22, 30]) * 1e-3)
    second = belt([[2e-3 * scale, -4e-3 * scale]], [24e-3 * scale])
    features = (
        Feature(OffsetLine(first), straight_wall(angle, depth, 8e-3, 8e-3)),
        Feature(OffsetLine(second), straight_wall(angle, second_depth, 8e-3, 6e-3), up=True),
    )
    return Part("free_form", features, FLANGE).centred()


def two_pockets(angle: float = np.radians(45), depth: float = 10e-3, second_depth: float = 7e-3) -> Part:
    """Two round pockets of different depth beside each other in one sheet."""
    first, second = belt([[-34e-3, 0.0]], [26e-3]), belt([[34e-3, 4e-3]], [22e-3])
    features = (
        Feature(OffsetLine(first), straight_wall(angle, depth, 6e-3, 6e-3)),
        Feature(OffsetLine(second), straight_wall(angle, second_depth, 6e-3, 6e-3)),
    )
    return Part("two_pockets", features, FLANGE, outline=(72e-3, 40e-3))


def marker(
    radius: float = 60e-3,
    angle: float = np.radians(45),
    depth: float = 4e-3,
    entry: float = 6e-3,
    floor: float = 6e-3,
) -> Part:
    """A truncated cone so shallow that a marker draws it on a board as rings, to compare upright and tilted tools."""
    return replace(cone(radius, angle, depth, entry, floor), name="marker")


def mask(scale: float = 1.0, angle: float = np.radians(50), depth: float = 18e-3, nose: float = 8e-3) -> Part:
    """A face, formed from its back: an oval with a nose that goes ``nose`` deeper, and two closed eyes."""
    oval = belt(scale * np.array([[0, -30], [0, 14]]) * 1e-3, scale * np.array([44, 62]) * 1e-3)
    bridge = belt(scale * np.array([[0, -18], [0, 0]]) * 1e-3, scale * np.array([19, 16]) * 1e-3)
    eyes = [belt(scale * np.array([[x, 24]]) * 1e-3, [scale * 13e-3]) for x in (-25, 25)]
    features = (
        Feature(OffsetLine(oval), straight_wall(angle, depth, 8e-3, 8e-3)),
        Feature(OffsetLine(bridge), straight_wall(np.radians(45), nose, 6e-3, 6e-3)),
        *(Feature(OffsetLine(eye), straight_wall(np.radians(35), 4e-3, 6e-3, 6e-3)) for eye in eyes),
    )
    return Part("mask", features, FLANGE).centred()


def implant(
    scale: float = 1.0,
    first_angle: float = np.radians(52),
    last_angle: float = np.radians(15),
    depth: float = 18e-3,
) -> Part:
    """A cranial implant: a dome with an irregular outline that flattens towards its crown."""
    centres = scale * np.array([[-26, -20], [28, -26], [34, 18], [-18, 28]]) * 1e-3
    line = belt(centres, scale * np.array([35, 33, 34, 37]) * 1e-3)
    profile = curved_wall(first_angle, last_angle, depth, 8e-3, 12e-3)
    return Part("implant", (Feature(OffsetLine(line), profile),), FLANGE).centred()


def bonnet(
    scale: float = 1.0,
    first_angle: float = np.radians(38),
    last_angle: float = np.radians(12),
    depth: float = 70e-3,
) -> Part:
    """The bonnet of a car: a shield, narrow in front and wide at the windscreen, that flattens towards its crown."""
    centres = scale * np.array([[0, -200], [235, 165], [0, 100], [-235, 165]]) * 1e-3
    line = belt(centres, scale * np.array([190, 175, 275, 175]) * 1e-3)
    profile = curved_wall(first_angle, last_angle, depth, 25e-3, 60e-3)
    return Part("bonnet", (Feature(OffsetLine(line), profile),), 2.5 * FLANGE).centred()


PARTS: dict[str, Callable[..., Part]] = {
    maker.__name__: maker
    for maker in (
        cone,
        funnel,
        pyramid,
        two_slope_pyramid,
        ribbed_pyramid,
        asymmetric_cone,
        fish_fin,
        heart,
        shamrock,
        airfoil_ridge,
        l_shape,
        star,
        free_form,
        two_pockets,
        marker,
        mask,
        implant,
        bonnet,
    )
}
"""Generators by name; every argument has a default."""
