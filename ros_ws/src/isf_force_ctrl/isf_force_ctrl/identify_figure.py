"""Picture of an identification: what was measured, and the fit to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from isf_force_ctrl.identify_fit import ComplianceFit, SignFit, StiffnessFit
from isf_force_ctrl.servo_probe import ServoFit


def draw_finding(fit: ComplianceFit | StiffnessFit | ServoFit | SignFit, path: Path) -> Path:
    """Write the picture of ``fit`` to ``path`` (PNG); returns the path."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    first, second = figure.subplots(1, 2)
    if isinstance(fit, ComplianceFit):
        _compliance(first, second, fit)
    elif isinstance(fit, StiffnessFit):
        _stiffness(first, second, fit)
    elif isinstance(fit, ServoFit):
        _servo(first, second, fit)
    else:
        _signs(first, second, fit)
    for axes in (first, second):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)
    return path


def _compliance(first: Axes, second: Axes, fit: ComplianceFit) -> None:
    closed = -1e6 * fit.gap
    first.plot(closed, fit.force, "o", ms=3.5, color="tab:blue", label="readings")
    order = np.argsort(fit.fitted)
    first.plot(-1e6 * fit.fitted[order], fit.force[order], "+", color="tab:orange", label="fit")
    first.set(xlabel="commanded squeeze, µm", ylabel="force along the line of centres, N")
    first.legend(frameon=False)
    second.axhline(0.0, color="0.7", lw=0.8)
    second.plot(fit.force, 1e6 * (fit.gap - fit.fitted), "o", ms=3.5, color="tab:blue")
    second.set(xlabel="force, N", ylabel="not explained, µm", title=f"rms {1e6 * fit.residual:.2f} µm")


def _stiffness(first: Axes, second: Axes, fit: StiffnessFit) -> None:
    first.plot(1e6 * fit.way, fit.force, "o", ms=3.5, color="tab:blue", label="readings")
    first.plot(1e6 * fit.way, fit.fitted, "+", color="tab:orange", label="fit of each visit")
    first.set(xlabel="way of tool 2 along d_n, µm", ylabel="horizontal normal force, N")
    first.legend(frameon=False)
    second.errorbar(range(1, len(fit.slopes) + 1), 1e-6 * fit.slopes, 1e-6 * fit.slope_deviation, fmt="o", capsize=3)
    second.axhline(1e-6 * fit.value, color="tab:orange")
    second.set(xlabel="visit", ylabel="contact stiffness, N/µm", ylim=(0.0, 1.3e-6 * float(fit.slopes.max())))


def _servo(first: Axes, second: Axes, fit: ServoFit) -> None:
    for axes, shown in ((first, slice(None)), (second, fit.time > 0.75 * fit.time[-1])):
        axes.plot(fit.time[shown], 1e6 * fit.command[shown], ".", ms=2.5, color="0.6", label="command")
        axes.plot(fit.time[shown], 1e6 * fit.report[shown], "o", ms=3.0, color="tab:blue", label="reported")
        axes.plot(fit.time[shown], 1e6 * fit.fitted[shown], "+", color="tab:orange", label="fit")
        axes.set(xlabel="time, s", ylabel="x, µm")
    first.legend(frameon=False)
    second.set_title(f"{fit.bandwidth:.2f} Hz")


def _signs(first: Axes, second: Axes, fit: SignFit) -> None:
    for axes, tool in ((first, 0), (second, 1)):
        axes.imshow(np.nan_to_num(fit.share[tool]), vmin=-1.0, vmax=1.0, cmap="coolwarm")
        for row in range(3):
            for column in range(3):
                value = fit.share[tool, row, column]
                axes.text(column, row, f"{value:.3f}" if np.isfinite(value) else "unseen", ha="center", va="center")
        axes.set(xticks=range(3), yticks=range(3), xticklabels=list("xyz"), yticklabels=["Fx", "Fy", "Fz"])
        axes.set(title=f"tool_{tool + 1}", xlabel="force along")
