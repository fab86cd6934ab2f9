"""Pictures of a tuning: responses of the laws, and the gain margin over contact stiffness and delay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from isf_force_ctrl.control_config import ControlConfig
from isf_force_ctrl.tuning import Law, Plant, corner_case, margin_map, ramp_case, respond, step_case

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
