"""Normals of the smooth surface behind the facets."""

from __future__ import annotations

import numpy as np
from isf_planner.surface.surface_kernels import vertex_normals
from isf_planner.surface.target_surface import facet_normals, smooth_along
from planner_parts import Cone, grid_mesh, revolve
from scipy.signal import savgol_filter


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def test_vertex_normals_of_a_sphere_are_far_better_than_facet_normals() -> None:
    turn = np.radians(np.linspace(60, 3, 20))
    mesh = revolve(np.column_stack([0.03 * np.sin(turn), -0.03 * (np.cos(turn) - np.cos(turn[0]))]), 60)
    normals = vertex_normals(mesh.vertices, mesh.faces)[0][mesh.faces]
    centre = np.array([0.0, 0.0, 0.03 * np.cos(turn[0])])
    inner = (np.abs(mesh.corners()[:, :, 2].mean(axis=1)) > 2e-3) & (mesh.corners()[:, :, 2].min(axis=1) > -14.5e-3)
    corners = mesh.corners()[inner]
    exact = (centre - corners) / np.linalg.norm(centre - corners, axis=2, keepdims=True)
    off = angle_between(normals[inner], exact)
    facet_off = angle_between(facet_normals(mesh)[inner][:, None, :], exact)
    # facets turn by 3 deg x 6 deg: their normals are off by about half of that; vertex averages only by unequal facets
    assert facet_off.max() > 1.4
    assert off.max() < 0.3


def test_how_quads_are_split_does_not_tilt_the_normals() -> None:
    """On a cylinder the axial component of every vertex normal is zero, whichever diagonal was drawn."""
    x = np.linspace(-0.01, 0.01, 21)
    y = np.linspace(-0.02, 0.02, 9)
    z = np.sqrt(0.03**2 - x**2) * -1 + 0.03
    mesh = grid_mesh(x, y, np.tile(z, (9, 1)))
    corners = mesh.corners().reshape(-1, 3)
    normals = vertex_normals(mesh.vertices, mesh.faces)[0][mesh.faces].reshape(-1, 3)
    inner = (np.abs(corners[:, 0]) < 9.5e-3) & (np.abs(corners[:, 1]) < 0.019)
    assert np.abs(normals[inner, 1]).max() < 1e-12
    exact = np.column_stack([-corners[inner, 0], np.zeros(inner.sum()), 0.03 - corners[inner, 2]]) / 0.03
    assert angle_between(normals[inner], exact).max() < 0.05  # second order of 2 deg between facets


def test_smoothing_keeps_the_normals_of_a_round_loop() -> None:
    """A parabola over 5 mm on a circle of 15 mm: error of the fit is far below 0.1 deg, a plain mean's is 0.3 deg."""
    angle = 2 * np.pi * np.arange(188) / 188
    wall = Cone().angle
    normals = np.column_stack([-np.sin(wall) * np.cos(angle), -np.sin(wall) * np.sin(angle), np.cos(wall) + 0 * angle])
    assert angle_between(smooth_along(normals, 0.5e-3, 5e-3), normals).max() < 0.05


def test_smoothing_removes_noise() -> None:
    angle = 2 * np.pi * np.arange(188) / 188
    exact = np.column_stack([-np.sqrt(0.5) * np.cos(angle), -np.sqrt(0.5) * np.sin(angle), np.full(188, np.sqrt(0.5))])
    noisy = exact + np.random.default_rng(0).normal(0, np.radians(0.5), exact.shape)
    before = angle_between(noisy, exact).std()
    assert angle_between(smooth_along(noisy, 0.5e-3, 5e-3), exact).std() < 0.6 * before


def test_smoothing_is_savitzky_and_golay_s() -> None:
    normals = np.random.default_rng(0).normal(size=(188, 3))
    smooth = savgol_filter(normals, 11, 2, axis=0, mode="wrap")
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    np.testing.assert_allclose(smooth_along(normals, 0.5e-3, 5e-3), smooth, atol=1e-12)
