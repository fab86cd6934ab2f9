"""Pictures of an identification (what was measured, the fit to it) and of a tuning (responses, gain margins)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from isf_force_ctrl.control_config import ControlConfig
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from isf_identify.fits import ComplianceFit, SignFit, StiffnessFit
from isf_identify.servo_probe import ServoFit
from isf_identify.tuning import Law, Plant, corner_case, margin_map, ramp_case, respond, step_case


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


COLOURS: dict[Law, str] = {"I": "#0072B2", "PI": "#D55E00", "P": "#999999"}
INK, BAND = "#1f2933", "#009E73"


def draw_responses(config: ControlConfig, plant: Plant, path: Path) -> Path:
    """Step, corner and ramp responses of the three laws on ``plant`` as a PNG at ``path``."""
    figure = Figure(figsize=(9.0, 7.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axes, case in zip(figure.subplots(3, 1), (step_case(), corner_case(), ramp_case()), strict=True):
        for law, colour in COLOURS.items():
            response = respond(config, plant, case, law)
            axes.plot(response.time, response.force, color=colour, lw=1.3, label=law)
            if law == "I":
                axes.plot(response.time, response.set_point, color=INK, lw=0.8)
                low, high = response.set_point - 10.0, response.set_point + 10.0
                axes.fill_between(response.time, low, high, color=BAND, alpha=0.15, lw=0)
        axes.set_ylabel("normal force, N")
        axes.set_title(case.name, loc="left", fontsize=10)
        axes.grid(alpha=0.3)
    axes.set_xlabel("time, s")
    figure.axes[0].legend(title="law", ncols=3, frameon=False)
    figure.suptitle(
        f"loop gain {config.loop_gain:g} 1/s, contact {plant.stiffness * 1e-6:.2f} N/um, "
        f"delay {plant.delay * 1e3:g} ms, "
        "band 10 N",
        fontsize=10,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


def draw_margin(config: ControlConfig, path: Path) -> Path:
    """Gain margin over K_c 0.2-2 N/um and 0-20 ms of additional delay as a PNG at ``path``."""
    stiffness, delay = np.linspace(0.2e6, 2.0e6, 37), np.linspace(0.0, 0.02, 21)
    figure = Figure(figsize=(9.0, 3.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    cases = ((0.0, "force control alone"), (config.compensation, "with compliance compensation"))
    for axes, (factor, title) in zip(figure.subplots(1, 2, sharey=True), cases, strict=True):
        margin = margin_map(replace(config, compensation=factor), stiffness, delay)
        shown = axes.contourf(
            stiffness * 1e-6, delay * 1e3, np.minimum(margin, 8.0), levels=[0, 1, 1.5, 2, 3, 4, 6, 8], cmap="viridis"
        )
        axes.contour(stiffness * 1e-6, delay * 1e3, margin, levels=[1.0], colors="white", linewidths=2)
        axes.plot([config.contact_stiffness * 1e-6], [0.0], "o", color="white", mec=INK, clip_on=False)
        axes.set_title(title, loc="left", fontsize=10)
        axes.set_xlabel("contact stiffness, N/um")
    figure.axes[0].set_ylabel("additional delay, ms")
    figure.colorbar(shown, ax=figure.axes, label="gain margin (white line: 1, unstable beyond)")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path
