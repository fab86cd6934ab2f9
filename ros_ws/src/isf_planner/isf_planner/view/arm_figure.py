"""What an arm does over a part, before anything runs: where it reaches, how it stands, its joints and its stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from isf_core.files.rig import Rig
from isf_core.geometry.kinematics import UPRIGHT
from isf_core.types import Array, Indices
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from isf_planner.checks.arm_checks import ArmClearance, ArmPath, boxes
from isf_planner.view.picture_files import save_png
from isf_planner.view.plan_figure import MUTED, STYLE, SUPPORT

MM, UM = 1e3, 1e6
_NODES = 61
"""Of the map along one side."""
_WIDER = 6.0
"""The map is this many times as wide as the travel: it shows where reach ends."""
_LEVELS = np.arange(0.0, 75.1, 7.5)
"""deg"""


def draw_arm(path: ArmPath, clearance: ArmClearance, rig: Rig, target: Path) -> Path:
    """Write the map of one arm as PNG to ``target`` and return it; IsfError FILE_NOT_WRITABLE."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(13.0, 9.6), layout="constrained")
        FigureCanvasAgg(figure)
        (above, beside), (joints, soft) = figure.subplots(2, 2)
        _draw_map(figure, above, path, rig)
        _draw_side(beside, path, clearance, rig)
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.tips, axis=0), axis=1))])
        _draw_joints(joints, path, way)
        _draw_softness(soft, path, way)
        figure.suptitle(
            f"{path.arm.name}, tool {path.tool}: at least {np.degrees(path.margin.min()):.0f} deg from the limits and "
            f"{np.degrees(path.singular.min()):.0f} deg from singular poses, roll {np.degrees(path.arm.roll):.0f} deg",
            x=0.01,
            ha="left",
            fontsize=12,
        )
        return save_png(figure, target)


def _draw_map(figure: Figure, axes: Axes, path: ArmPath, rig: Rig) -> None:
    """How far the upright tool is from limits and singular poses at the level farthest from the flat sheet."""
    level = float(path.tips[np.argmax(np.abs(path.tips[:, 2])), 2])
    x = np.linspace(-_WIDER, _WIDER, _NODES) * rig.limits.travel[0]
    y = np.linspace(-_WIDER, _WIDER, _NODES) * rig.limits.travel[1]
    gx, gy = np.meshgrid(x, y)
    _, margin, singular = path.arm.held(np.stack([gx, gy, np.full_like(gx, level)], axis=-1), UPRIGHT)
    left = np.degrees(np.minimum(margin, singular))
    left[left < 0.0] = np.nan
    shown = axes.contourf(gx * MM, gy * MM, left, levels=_LEVELS, cmap="viridis", extend="max")
    axes.plot(*(path.tips[:, :2] * MM).T, color=SUPPORT, lw=0.6)
    a, b = (value * MM for value in rig.limits.travel[:2])
    axes.add_patch(Rectangle((-a, -b), 2 * a, 2 * b, fill=False, ec=MUTED, lw=1.5))
    axes.set(
        title=f"From limits and singular poses at z = {level * MM:.1f} mm",
        xlabel="x in mm",
        ylabel="y in mm",
        aspect="equal",
    )
    label = "deg (white: out of reach; frame: travel)"
    figure.colorbar(shown, ax=axes, label=label)


def _draw_side(axes: Axes, path: ArmPath, clearance: ArmClearance, rig: Rig) -> None:
    """The arm where a link comes nearest to anything, seen in the plane of its base and the sheet."""
    places, _ = path.arm.frames(path.joints[clearance.row])
    out = -places[0]
    flat = np.array([1.0, 0.0, 0.0]) if np.hypot(*out[:2]) < 1e-6 else np.array([*out[:2], 0.0])
    flat /= np.linalg.norm(flat)
    across = places @ flat
    axes.plot(across * MM, places[:, 2] * MM, color=SUPPORT, lw=5, alpha=0.5, solid_capstyle="round")
    axes.plot(across[:-1] * MM, places[:-1, 2] * MM, "o", color=MUTED, ms=7)
    for joint, at, z in zip(path.arm.joints, across[1:], places[1:, 2], strict=False):
        axes.annotate(joint.name, (at * MM, z * MM), textcoords="offset points", xytext=(8, 6), fontsize=9)
    for box in boxes(rig):
        corners = np.array([[x, y, 0.0] for x in (box.low[0], box.high[0]) for y in (box.low[1], box.high[1])]) @ flat
        size = (corners.max() - corners.min()) * MM, (box.high[2] - box.low[2]) * MM
        axes.add_patch(Rectangle((corners.min() * MM, box.low[2] * MM), *size, color=MUTED, alpha=0.5))
    near = f"{clearance.link} {clearance.distance * MM:.0f} mm from {clearance.other}"
    axes.set(title=near[0].upper() + near[1:], aspect="equal", ylabel="z in mm")
    axes.set_xlabel("from the middle of the sheet, away from the base, mm")


def _draw_joints(axes: Axes, path: ArmPath, way: Array) -> None:
    rows = _shown(len(way))
    for k, joint in enumerate(path.arm.joints):
        share = (path.joints[rows, k] - joint.middle) / joint.span
        axes.plot(way[rows], share, lw=1.0, label=joint.name)
    for end in (-1.0, 1.0):
        axes.axhline(end, color=MUTED, lw=1.5)
    axes.set(
        title="Joints along the path", xlabel="path in m", ylabel="position, -1 and 1 at the limits", ylim=(-1.15, 1.35)
    )
    axes.legend(ncols=6, fontsize=9, loc="upper right")


def _draw_softness(axes: Axes, path: ArmPath, way: Array) -> None:
    rows = _shown(len(way))
    soft = path.arm.compliance(path.joints[rows]) * UM
    for label, (i, j) in {"x": (0, 0), "y": (1, 1), "z": (2, 2), "x by force in z": (0, 2)}.items():
        axes.plot(way[rows], soft[:, i, j], lw=1.2, label=label)
    give = np.linalg.norm(path.give, axis=1).max()
    title = f"Compliance: {give * MM:.2f} mm under the predicted force"
    axes.set(title=title, xlabel="path in m", ylabel="um/N")
    axes.legend(ncols=4, fontsize=9)


def _shown(count: int) -> Indices:
    """Rows that are drawn."""
    return np.unique(np.linspace(0, count - 1, min(count, 2000)).astype(np.int64))


def arm_pictures(paths: Sequence[ArmPath], clearances: Sequence[ArmClearance], rig: Rig, folder: Path) -> list[Path]:
    """One picture for each arm, ``reach.png`` and, of a lower arm beside an upper one, ``reach_2.png``."""
    names = ["reach.png"] + [f"reach_{path.tool}.png" for path in paths[1:]]
    return [
        draw_arm(path, clearance, rig, folder / name)
        for path, clearance, name in zip(paths, clearances, names, strict=True)
    ]
