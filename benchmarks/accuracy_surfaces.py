"""Accuracy surfaces: 14 small parts formed, each predicted and formed again with what was learned from the others.

usage: ./isf python benchmarks/accuracy_surfaces.py FOLDER [--jobs N] [STEP...]
STEPs, all of them without one: form (parts as they are), models (which model predicts held-out parts best), again
(every part with the surfaces learned from all other shapes), steel (the
airfoil of Behera 2015), sealed (two parts on variants 101 to 105, which are kept to
publish results with), cones (measured cones of benchmarks/data), picture. A part takes 10 to 30 s of one core; what is
in FOLDER already is not formed again.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from isf_analysis.bag.bag_reader import read_bag
from isf_core.geometry.height_map import HeightMap
from isf_core.types import Array
from isf_planner.accuracy import formed_parts, surfaces
from isf_planner.accuracy.formed_parts import Conditions, FormedPart, FormedParts, formed_part
from isf_planner.accuracy.places import NUMBERS, PREDICTORS
from isf_planner.part_library import PARTS, part_mesh

HERE = Path(__file__).resolve().parent
ISF = HERE.parent / "isf"

JOB = """\
name: {name}
part: {{mesh: {mesh}.stl, unit: mm{surfaces}}}
process: SPIF
rig: behera2015
sheet: {{material: {material}, thickness: {thickness} mm}}
tool_1: {{radius: 5 mm}}
backing_plate: {{shape: {shape}, size: [{x:.1f} mm, {y:.1f} mm]{corner}}}
path: {{incremental_depth: {step} mm, point_spacing: 0.5 mm, feed: 60 mm/s}}
control: {{rate: 500 Hz}}
springback: {{method: none}}
"""

SHAPES: dict[str, tuple[str, dict[str, float]]] = {
    "cone40": ("cone", {"radius": 22e-3, "angle": 40, "depth": 8e-3}),
    "cone52": ("cone", {"radius": 26e-3, "angle": 52, "depth": 12e-3}),
    "cone30": ("cone", {"radius": 30e-3, "angle": 30, "depth": 7e-3}),
    "cone46": ("cone", {"radius": 34e-3, "angle": 46, "depth": 14e-3}),
    "pyramid45": ("pyramid", {"half_side": 26e-3, "corner": 15e-3, "angle": 45, "depth": 9e-3}),
    "pyramid55": ("pyramid", {"half_side": 30e-3, "corner": 15e-3, "angle": 55, "depth": 12e-3}),
    "pyramid36": ("pyramid", {"half_side": 36e-3, "corner": 24e-3, "angle": 36, "depth": 9e-3}),
    "funnel": ("funnel", {"radius": 26e-3, "first_angle": 55, "last_angle": 25, "depth": 10e-3}),
    "bowl": ("funnel", {"radius": 32e-3, "first_angle": 25, "last_angle": 50, "depth": 10e-3}),
    "oblique": ("asymmetric_cone", {"radius": 28e-3, "depth": 9e-3, "entry": 6e-3, "floor": 7e-3}),
    "two_slope": (
        "two_slope_pyramid",
        {"half_side": 38e-3, "corner": 24e-3, "upper_length": 8e-3, "lower_length": 6e-3},
    ),
    "heart": ("heart", {"depth": 8e-3}),
    "fin": ("fish_fin", {"depth": 8e-3}),
    "airfoil": ("airfoil_ridge", {}),
}
"""Parts of the library in other sizes, m and deg."""

ROUND = ("cone", "funnel", "asymmetric_cone")
CORNER = {"heart": 12.0, "fish_fin": 10.0, "airfoil_ridge": 12.0}
"""mm, radius of the backing plate's corners, of parts without one of their own."""

OTHER_THICKNESS = {
    **dict.fromkeys(("cone40", "cone46", "pyramid45", "pyramid36", "bowl", "two_slope"), 1.5),
    **dict.fromkeys(("cone52", "funnel", "oblique"), 0.7),
    "heart": 1.2,
}
"""mm; these parts are also formed of another blank than one of 1 mm."""

STEEL = ("AISI-304", 0.5, 0.25)
"""Sheet, mm and depth step, mm, of the airfoil of Behera 2015."""

STEEL_PARTS = ("cone40", "pyramid36", "funnel", "bowl", "heart")
"""Parts that are formed of it to learn from; walls that it bears."""

SEALED = range(101, 106)
SEALED_PARTS = ("oblique", "heart")

Rows = list[dict[str, Any]]


def write_job(folder: Path, name: str, surfaces_file: str | None = None) -> Path:
    """Mesh and job of part ``name``, which may end with its thickness in tenths of mm, "cone40_15", or "_steel"."""
    shape = name.rsplit("_", 1)[0] if name.rsplit("_", 1)[-1] in ("steel", "7", "12", "15") else name
    steel = name.endswith("_steel")
    thickness = 1.0 if shape == name else STEEL[1] if steel else 0.1 * int(name.rsplit("_", 1)[1])
    kind, sizes = SHAPES[shape]
    part = PARTS[kind](**{key: np.radians(value) if "angle" in key else value for key, value in sizes.items()})
    mesh = part_mesh(part)
    if not (folder / f"{shape}.stl").exists():
        trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(folder / f"{shape}.stl")
    x, y = 1e3 * np.ptp(mesh.vertices[:, :2], axis=0) - 16.0 + 6.0  # flange 8 mm; the plate stands 3 mm off the opening
    corner = ""
    if kind not in ROUND:
        corner = f", corner_radius: {1e3 * sizes['corner'] if 'corner' in sizes else CORNER[kind]:.1f} mm"
    else:
        x = y = max(x, y)
    path = folder / f"{name}{'_again' if surfaces_file else ''}.yaml"
    asked = f", accuracy_surfaces: {surfaces_file}" if surfaces_file else ""
    plate = "rectangle" if corner else "circle"
    path.write_text(
        JOB.format(
            name=path.stem,
            mesh=shape,
            surfaces=asked,
            material=STEEL[0] if steel else "AA3103",
            thickness=f"{thickness:g}",
            step=STEEL[2] if steel else 0.5,
            shape=plate,
            x=x,
            y=y,
            corner=corner,
        )
    )
    return path


def simulate(job: Path, variant: int = 0) -> Path:
    """The run of ``job``, formed unless it was before; raises CalledProcessError when the part is not formed."""
    run = job.parent / "runs" / (job.stem if variant == 0 else f"{job.stem}-{variant}")
    if not (run / "bag" / "metadata.yaml").exists():
        command = [str(ISF), "simulate", str(job), "--no-compare", "--json", "-o", str(run)]
        done = subprocess.run([*command, "--variant", str(variant)], capture_output=True, text=True, check=False)
        if not (run / "bag" / "metadata.yaml").exists():
            raise RuntimeError(f"{job.stem}: {done.stderr[-800:]}")
    return run


def names() -> list[str]:
    """All parts that are formed."""
    return [*SHAPES, *(f"{name}_{10 * thickness:.0f}" for name, thickness in OTHER_THICKNESS.items())]


def known(folder: Path) -> FormedParts:
    """What was formed, as samples."""
    return learned(folder, names(), folder / "all.npz")


def learned(folder: Path, of: Sequence[str], path: Path) -> FormedParts:
    """What was learned from the runs ``of`` these parts, kept in the file ``path``."""
    if path.exists():
        return formed_parts.load(path)
    parts, conditions = [], None
    for name in of:
        record = read_bag(folder / "runs" / name)
        job = record.job()
        assert record.target is not None
        assert record.scan is not None
        conditions = Conditions.of(job)
        parts.append(formed_part(name, record.target, record.scan, job.tool_1.ball_radius, job.sheet.thickness))
    assert conditions is not None
    formed = surfaces.with_held_out(FormedParts(conditions, tuple(parts)))
    formed_parts.save(formed, path)
    return formed


def errors(run: Path) -> dict[str, Any]:
    """Table 2 of Behera 2015 and the vertical errors of wall and base, mm, of a run."""
    from isf_analysis.measures.summary import summary

    told = summary(read_bag(run))
    deviation = told["deviation"]
    return {"complete": told["complete"], "rms": deviation["rms_mm"], "max": deviation["max_mm"]} | deviation["table2"]


# models --------------------------------------------------------------------------------------------------------------

Fit = Callable[[Sequence[FormedPart]], Callable[[Array], Array]]


def mean(parts: Sequence[FormedPart]) -> Callable[[Array], Array]:
    """The mean of all parts."""
    _, deviation, weight = surfaces.samples(parts)
    value = float(np.average(deviation, weights=weight))
    return lambda values: np.full(len(values), value)


def hinges(parts: Sequence[FormedPart]) -> Callable[[Array], Array]:
    """A sum of hinge functions of single predictors, its ridge chosen by parts held out among ``parts``."""
    from sklearn.linear_model import Ridge
    from sklearn.preprocessing import SplineTransformer, StandardScaler

    values, deviation, weight = surfaces.samples(parts)
    of = np.concatenate([np.full(len(part.deviation), part.shape) for part in parts])
    used = np.flatnonzero(np.ptp(values[:, : len(NUMBERS)], axis=0) > 0.0)
    splines = SplineTransformer(n_knots=5, degree=1, extrapolation="constant", include_bias=False)
    scaler = StandardScaler()

    def columns(of_values: Array, *, fit: bool = False) -> Array:
        basis = (splines.fit_transform if fit else splines.transform)(of_values[:, used])
        whole = np.hstack([basis, of_values[:, len(NUMBERS) :]])
        return np.asarray((scaler.fit_transform if fit else scaler.transform)(whole))

    basis, left = columns(values, fit=True), []
    ridges = 10.0 ** np.arange(-3.0, 2.0)
    for ridge in ridges:
        wrong = 0.0
        for shape in np.unique(of):
            out = of == shape
            model = Ridge(ridge * weight[~out].sum()).fit(basis[~out], deviation[~out], sample_weight=weight[~out])
            wrong += float(weight[out] @ (deviation[out] - model.predict(basis[out])) ** 2)
        left.append(wrong)
    best = Ridge(ridges[int(np.argmin(left))] * weight.sum()).fit(basis, deviation, sample_weight=weight)
    return lambda wanted: np.asarray(best.predict(columns(wanted)))


def process(parts: Sequence[FormedPart]) -> Callable[[Array], Array]:
    """A Gaussian process of 40 places of every part."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    few = [replace(p, values=p.values[:40], deviation=p.deviation[:40], weight=p.weight[:40]) for p in parts]
    values, deviation, _ = surfaces.samples(few)
    middle, spread, level, size = values.mean(0), values.std(0) + 1e-9, deviation.mean(), deviation.std()
    kernel = ConstantKernel(1.0) * RBF(5.0) + WhiteKernel(0.05)
    model = GaussianProcessRegressor(kernel).fit((values - middle) / spread, (deviation - level) / size)
    return lambda wanted: np.asarray(model.predict((wanted - middle) / spread) * size + level)


def trees(parts: Sequence[FormedPart]) -> Callable[[Array], Array]:
    """What the software uses."""
    return surfaces.fit(parts).predict


def monotone(parts: Sequence[FormedPart]) -> Callable[[Array], Array]:
    """The same, which may only rise with depth and with the distance to the rim."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    values, deviation, weight = surfaces.samples(parts)
    rising = [int(name.startswith(("depth [m]", "distance to the rim"))) for name in PREDICTORS]
    model = HistGradientBoostingRegressor(
        **surfaces.BOOSTING, l2_regularization=surfaces.SHRINKAGE, monotonic_cst=rising
    )
    model.fit(values, 1e3 * deviation, sample_weight=weight)
    return lambda wanted: np.asarray(1e-3 * model.predict(wanted))


MODELS: dict[str, Fit] = {
    "mean": mean,
    "hinge functions": hinges,
    "Gaussian process": process,
    "trees": trees,
    "trees, monotone": monotone,
}


def held_out(parts: Sequence[FormedPart], groups: Sequence[str], fit: Fit) -> Rows:
    """Every part predicted from those of the other ``groups`` (one for each part); mm."""
    rows = []
    for group in dict.fromkeys(groups):
        predict = fit([part for part, other in zip(parts, groups, strict=True) if other != group])
        for part, own in zip(parts, groups, strict=True):
            if own == group:
                left = part.deviation - predict(part.values)
                rows.append(
                    {"name": part.name, "before": 1e3 * part.rms(part.deviation), "after": 1e3 * part.rms(left)}
                )
    return rows


def tell_models(parts: Sequence[FormedPart], groups: Sequence[str], among: Sequence[str] = tuple(MODELS)) -> None:
    """Print how well each model predicts parts that were held out."""
    for name in among:
        rows = held_out(parts, groups, MODELS[name])
        before, after = (np.array([row[key] for row in rows]) for key in ("before", "after"))
        worst = rows[int(np.argmax(after))]["name"]
        print(
            f"{name:17s} {np.sqrt(np.mean(before**2)):.3f} -> {np.sqrt(np.mean(after**2)):.3f} mm rms, worst "
            f"{after.max():.3f} ({worst}), better on {(after < before).sum()} of {len(rows)}",
            flush=True,
        )


def cone_parts() -> tuple[list[FormedPart], list[str]]:
    """The measured cones and their wall angles; nominal cones with sharp edges, the sheet taken as 1.5 mm."""
    rows: dict[tuple[str, ...], list[tuple[float, float]]] = {}
    with (HERE / "data" / "spif_cones_measured.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = tuple(row[k] for k in ("part", "wall_angle_deg", "height_mm", "tool_diameter_mm"))
            rows.setdefault(key, []).append((float(row["r_mm"]), float(row["depth_mm"])))
    grid = 1e-3 * np.arange(-70, 71)
    radius = np.hypot(*np.meshgrid(grid, grid))
    parts, angles = [], []
    for (name, angle, height, tool), profile in rows.items():
        wall = (50e-3 - radius) * np.tan(np.radians(float(angle)))
        target = HeightMap(grid, grid, -np.clip(wall, 0.0, 1e-3 * float(height)))
        r, depth = 1e-3 * np.array(profile).T
        measured = HeightMap(grid, grid, -np.interp(radius, r, depth))
        parts.append(formed_part(name, target, measured, 0.5e-3 * float(tool), 1.5e-3))
        angles.append(angle)
    return parts, angles


# steps ---------------------------------------------------------------------------------------------------------------


def form(folder: Path, jobs: int) -> None:
    """All parts as they are."""
    paths = [write_job(folder, name) for name in names()]
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(simulate, paths))


def models(folder: Path, jobs: int) -> None:
    """Which model predicts held-out parts best."""
    formed = known(folder)
    tell_models(formed.parts, [part.shape for part in formed.parts])


def without(formed: FormedParts, name: str, folder: Path) -> str:
    """File of what was learned from all shapes but that of part ``name``."""
    shape = next(part.shape for part in formed.parts if part.name == name)
    file = f"without_{name}.npz"
    rest = tuple(part for part in formed.parts if part.shape != shape)
    formed_parts.save(replace(formed, parts=rest), folder / file)
    return file


def again(folder: Path, jobs: int) -> None:
    """Every part with what was learned from the other shapes."""
    formed = known(folder)
    paths = [write_job(folder, name, without(formed, name, folder)) for name in SHAPES]
    with ThreadPoolExecutor(jobs) as pool:
        runs = list(pool.map(simulate, paths))
    print("| part | rms | max | mean of + | mean of - | largest | smallest | mean | std |")
    for name, run in zip(SHAPES, runs, strict=True):
        _tell(name, errors(folder / "runs" / name), errors(run))


def sealed(folder: Path, jobs: int) -> None:
    """The same on machines and sheets that differ from the one that was learned from."""
    formed = known(folder)
    for name in SEALED_PARTS:
        for variant in SEALED:
            plain = simulate(write_job(folder, name), variant)
            moved = simulate(write_job(folder, name, without(formed, name, folder)), variant)
            _tell(f"{name} {variant}", errors(plain), errors(moved))


def _tell(name: str, before: dict[str, Any], after: dict[str, Any]) -> None:
    keys = ("rms", "max", "mean_positive_mm", "mean_negative_mm", "max_mm", "min_mm", "mean_mm", "std_mm")
    cells = []
    for key in keys:
        cells.append(" -> ".join("-" if one[key] is None else f"{one[key]:.2f}" for one in (before, after)))
    torn = "" if after["complete"] else " (not complete)"
    print(f"| {name}{torn} | {' | '.join(cells)} |", flush=True)


def steel(folder: Path, jobs: int) -> None:
    """The airfoil of Behera 2015: ordinary, and with what was learned from other parts of the same sheet."""
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(simulate, [write_job(folder, f"{name}_steel") for name in STEEL_PARTS]))
    path = folder / "steel.npz"
    formed = learned(folder, [f"{name}_steel" for name in STEEL_PARTS], path)
    print(f"held out: {1e3 * formed.uncertainty:.3f} mm rms")
    for part in formed.parts:
        print(f"{part.name}: {1e3 * part.rms(part.deviation):.3f} -> {1e3 * part.left:.3f} mm rms")
    job = HERE.parent / "examples" / "jobs" / "behera_airfoil.yaml"
    text = job.read_text().replace("../parts/behera_airfoil.stl", str(job.parents[1] / "parts" / "behera_airfoil.stl"))
    plain, moved = folder / "behera_airfoil.yaml", folder / "behera_airfoil_again.yaml"
    plain.write_text(text)
    moved.write_text(text.replace("  unit: mm\n", f"  unit: mm\n  accuracy_surfaces: {path.name}\n", 1))
    with ThreadPoolExecutor(jobs) as pool:
        before, after = pool.map(simulate, [plain, moved])
    _tell("behera_airfoil", errors(before), errors(after))


def cones(folder: Path, jobs: int) -> None:
    """Cones that were formed and measured in a laboratory."""
    parts, angles = cone_parts()
    print("each cone from the others:")
    tell_models(parts, [part.name for part in parts], ("mean", "hinge functions", "trees"))
    print("each wall angle from the others:")
    tell_models(parts, angles, ("mean", "hinge functions", "trees"))
    print("learned from cones of 40 and 60 deg with steps of 0.3 mm alone, with the fading outside of the range:")
    few = [p for p in parts if p.name in ("I", "XXIII")]
    model = surfaces.fit(few)
    for part, angle in zip(parts, angles, strict=True):
        if part not in few:
            trust, _ = model._trust(part.values, np.ones(len(part.values), dtype=np.bool_))
            left = part.deviation - trust * model.predict(part.values)
            print(
                f"{part.name:7s} {angle} deg: {1e3 * part.rms(part.deviation):.2f} -> {1e3 * part.rms(left):.2f} mm, "
                f"{1.0 - trust.mean():.0%} outside"
            )


def picture(folder: Path, jobs: int, name: str = "heart") -> None:
    """Deviation of a held-out part: predicted, measured, and what is left when it is formed again."""
    from isf_core.files.job import load_job
    from isf_planner import plan
    from matplotlib.figure import Figure

    moved = plan(load_job(write_job(folder, name, without(known(folder), name, folder)))).moved
    assert moved is not None
    x, y = moved.expected.x, moved.expected.y
    maps = [("predicted from the other shapes", moved.expected.z)]
    inside = np.isfinite(moved.expected.z)
    for title, run in (("measured", name), ("measured with accuracy surfaces", f"{name}_again")):
        record = read_bag(folder / "runs" / run)
        assert record.target is not None
        assert record.scan is not None
        points = np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])
        slope = HeightMap(record.target.x, record.target.y, np.hypot(*record.target.gradient())).at(points)
        error = (record.scan.at(points) - record.target.at(points)) / np.sqrt(1.0 + slope**2)
        maps.append((title, np.where(inside, error.reshape(inside.shape), np.nan)))
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, (title, values) in zip(axes, maps, strict=True):
        shown = ax.pcolormesh(1e3 * x, 1e3 * y, 1e3 * values, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        rms = 1e3 * np.sqrt(np.nanmean(values**2))
        ax.set(aspect="equal", xlabel="x in mm", title=f"{title}: {rms:.2f} mm rms")
    axes[0].set_ylabel("y in mm")
    figure.colorbar(shown, ax=axes, label="deviation along the normal in mm, + too shallow", shrink=0.8)
    figure.savefig(folder / "accuracy_surfaces.png", dpi=100)
    print(folder / "accuracy_surfaces.png")


STEPS = {one.__name__: one for one in (form, models, again, steel, sealed, cones, picture)}


def main() -> None:
    """Run the steps that are asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=", ".join(STEPS))
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    if unknown := set(given.steps) - set(STEPS):
        sys.exit(f"no step {', '.join(sorted(unknown))}; there are {', '.join(STEPS)}")
    folder = given.folder.resolve()
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    for name in given.steps or STEPS:
        print(f"== {name}", flush=True)
        STEPS[name](folder, given.jobs)


if __name__ == "__main__":
    main()
