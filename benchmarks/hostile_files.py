"""Damaged files of every kind that is read from outside: what is no coded error, takes long, or fills the memory.

usage: ./isf python benchmarks/hostile_files.py [--count 10000] [--seed 7] [--kinds job mesh.obj ...] [--json]

Jobs, rigs, materials, tools, blanks, campaigns, set-ups, job texts and options of commands, plans, springback
databases, what was learned, saved states, meshes (STL, OBJ, PLY, OFF, 3MF, STEP), programs, and tables of load cells,
gauges, errors and points are damaged one after the other, the same ones for the same seed, and read as the software
reads them. At first every kind is replaced by what is no file of its kind at all: a pipe, a folder, a device, an empty
or huge file, bytes, texts in another encoding; and packed ones by what unpacks to gigabytes.

Each is read in a process of its own kind, which tells its processor time and its largest memory; one that does not
answer is ended. An error of any other class than IsfError, or IsfError INTERNAL, counts as unexpected, and so does a
process that ends. Exit code 1 where there is any, or a reading over 5 s or 1 GB. Ctrl-C ends it and prints what was
measured until then.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from damaged import (  # noqa: E402
    HOSTILE,
    STRANGE,
    damaged_arrays,
    damaged_bytes,
    damaged_table,
    damaged_text,
    put_strange,
)
from isf_analysis.measures.plan_mask import shapes_of  # noqa: E402
from isf_cell.campaign.rows_file import read_rows  # noqa: E402
from isf_cell.commands.calibrate_cell import calibrate_file  # noqa: E402
from isf_cell.commands.identify_dial import read_dial  # noqa: E402
from isf_cell.commands.resume import Request  # noqa: E402
from isf_cell.replay import what_if  # noqa: E402
from isf_cell.shape_file import load_shape  # noqa: E402
from isf_core.errors import ErrorCode, IsfError  # noqa: E402
from isf_core.files import archive  # noqa: E402
from isf_core.files.campaign import CampaignFile  # noqa: E402
from isf_core.files.die_mesh import read_die  # noqa: E402
from isf_core.files.job import JobFile, load_job  # noqa: E402
from isf_core.files.material import load_material  # noqa: E402
from isf_core.files.rig import load_rig  # noqa: E402
from isf_core.files.tooling import LIBRARIES, load_named  # noqa: E402
from isf_core.files.yaml_file import share_directory  # noqa: E402
from isf_planner import plan  # noqa: E402
from isf_planner.accuracy import formed_parts  # noqa: E402
from isf_planner.accuracy.places import PREDICTORS  # noqa: E402
from isf_planner.exports.plan_file import load_plan, save_plan  # noqa: E402
from isf_planner.gcode.reader import program_text, read_program  # noqa: E402
from isf_planner.gcode.set_up import load_set_up  # noqa: E402
from isf_planner.part.mesh_checks import check_and_place  # noqa: E402
from isf_planner.part.meshes import load_mesh  # noqa: E402
from isf_planner.part_plan import Plan  # noqa: E402
from isf_planner.predict import machine_error  # noqa: E402
from isf_sim.machine.axes import read_error_map  # noqa: E402
from isf_springback.database.database import Database, DatabaseLevel  # noqa: E402
from isf_springback.estimators import learning  # noqa: E402
from isf_springback.shell.edge_calibration import read_push_curve  # noqa: E402

JOBS = ROOT / "examples" / "jobs"
CLAMP = (0.182, 0.182)
LONGEST = 5.0
"""s of processor time for one reading."""
MOST = 1000.0
"""MB of memory of a process that reads, with everything that it has loaded."""
PATIENCE = 60.0
"""s by the wall clock until a process is ended that does not answer: a pipe takes no processor time."""
SHOWN = 20
"""Unexpected errors of which the place is told."""


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    name : of the kind; ``suffix`` : of its files, or their whole name
    whole : files as they are meant to be, or the arrays of an archive
    read : reads the file at a path, as the software does
    damage : makes what is written of one of ``whole``
    strange : True where anything else may lie in its place
    share : how many are read of it, to how many of others
    """

    name: str
    suffix: str
    whole: Sequence[Any]
    read: Callable[[Path], Any]
    damage: Callable[[Any, random.Random], bytes]
    strange: bool = True
    share: float = 1.0


def of_text(text: str, chance: random.Random) -> bytes:
    """A damaged text of lines with fields; one in ten has damaged bytes."""
    damaged = damaged_text(text, chance).encode("utf-8", "surrogatepass")
    return damaged_bytes(damaged, chance) if chance.random() < 0.1 else damaged


def of_table(text: str, chance: random.Random) -> bytes:
    """A damaged table, mesh in text, or program."""
    damaged = damaged_table(text, chance) if chance.random() < 0.7 else damaged_text(text, chance)
    content = damaged.encode("utf-8", "surrogatepass")
    return damaged_bytes(content, chance) if chance.random() < 0.1 else content


def of_arrays(arrays: Mapping[str, Any], chance: random.Random) -> bytes:
    """A damaged archive: other arrays in four of five, else damaged bytes."""
    if chance.random() < 0.8:
        return damaged_arrays(arrays, chance)
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return damaged_bytes(stream.getvalue(), chance)


def of_json(text: str, chance: random.Random) -> bytes:
    """JSON with one value in place of another, or damaged bytes."""
    if chance.random() < 0.3:
        return damaged_bytes(text.encode(), chance)
    data = json.loads(text)
    place: Any = data
    while True:
        key = chance.choice(list(place)) if isinstance(place, dict) else chance.randrange(len(place))
        if not isinstance(place[key], dict | list) or not place[key] or chance.random() < 0.3:
            break
        place = place[key]
    place[key] = chance.choice((None, True, -1, 10**400, 1e308, float("nan"), float("inf"), "x", [], {}, [[1]], [None]))
    return json.dumps(data).encode()


def of_zipped_mesh(model: str, chance: random.Random) -> bytes:
    """A 3MF with a damaged model; one in three has damaged bytes."""
    damaged = of_table(model.replace('"', ' " '), chance).replace(b' " ', b'"')
    content = zipped({"3D/3dmodel.model": damaged})
    return damaged_bytes(content, chance) if chance.random() < 0.3 else content


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A compressed zip."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in files.items():
            file.writestr(name, content)
    return stream.getvalue()


@cache
def bomb(member: str) -> bytes:
    """A zip of some MB that unpacks to 1.2 GB of blanks."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open(member, "w", force_zip64=True) as part,
    ):
        for _ in range(120):
            part.write(b" " * 10_000_000)
    return stream.getvalue()


def kinds(folder: Path) -> list[Kind]:
    """Every kind; ``folder`` takes what has to be made for them."""
    return [*_texts(folder), *_tables(), *_archives(folder), *_meshes()]


def _texts(folder: Path) -> Iterator[Kind]:
    def texts(*paths: Path) -> list[str]:
        return [path.read_text(encoding="utf-8") for path in paths]

    share = share_directory()
    jobs = texts(*sorted(JOBS.glob("*.yaml")))
    mini = (JOBS / "mini_cone.yaml").read_text(encoding="utf-8")
    campaign = ROOT / "examples" / "campaigns" / "mini_cone.yaml"
    yield Kind("job", ".yaml", jobs, load_job, of_text)
    yield Kind("job-text", ".yaml", jobs, lambda path: JobFile(_given(path), JOBS), of_text, strange=False)
    yield Kind(
        "rig", ".yaml", texts(*sorted((share / "rigs").glob("*.yaml"))), lambda path: load_rig(str(path)), of_text
    )
    materials = texts(*sorted((share / "materials").glob("*.yaml")))
    yield Kind("material", ".yaml", materials, lambda path: load_material(str(path)), of_text)
    for library in LIBRARIES:
        whole = texts(*sorted((share / library.folder).glob("*.yaml")))
        yield Kind(library.folder, ".yaml", whole, lambda path, of=library: load_named(of, str(path)), of_text)
    yield Kind("campaign", ".yaml", texts(campaign), CampaignFile, of_text)
    set_up = "work_offsets:\n  G54: [1 mm, 2 mm, 0 mm]\ntools:\n  1: {length: 80 mm, radius: 5 mm}\n"
    yield Kind("set-up", ".yaml", [set_up], load_set_up, of_text)
    options = ["springback.gain=0.5", "force.loop_gain=20", "control.support_force=100 N", "force.aside=[0, 0, 1]"]
    yield Kind(
        "option",
        ".txt",
        options,
        lambda path: what_if.parse([_given(path)]).job_text(mini),
        lambda text, chance: (
            f"{text.partition('=')[0]}={chance.choice(HOSTILE)}".encode()
            if chance.random() < 0.5
            else of_text(text, chance)
        ),
        strange=False,
    )
    loads, depths = np.array([100.0, 200.0, 400.0]), np.linspace(1e-4, 4e-4, 3)
    points = np.array([[0.03, 0.0, -1e-3], [0.0, 0.03, -1e-3]])
    level = DatabaseLevel(1, 0, -1e-3, points, np.array([True, False]), np.stack([depths, 2 * depths]))
    Database("mini_cone", loads, (level, level), 2).save(folder / "database.json")
    yield Kind("database", ".json", texts(folder / "database.json"), Database.load, of_json)
    rows = '{"key": "a", "value": 1.0}\n{"key": "b", "value": [1, 2]}\n'
    yield Kind("campaign-rows", ".jsonl", [rows], read_rows, of_text)
    yield Kind("request", "run/checkpoint/request.json", ['{"job": "a.yaml", "attach": true}'], _request, of_json)


def _given(path: Path) -> str:
    """A text as a message or a command line brings it."""
    return path.read_bytes().decode("utf-8", "replace")


def _request(path: Path) -> Any:
    return Request.read(path.parents[1])


def _tables() -> Iterator[Kind]:
    chance = np.random.default_rng(1)
    cells = "fx,fy,fz,u1,u2,u3\n" + "".join(
        ",".join(f"{value:.3f}" for value in (*row, *(row / 50.0))) + "\n" for row in chance.normal(0.0, 100.0, (8, 3))
    )
    channels = "load,X,Y\n" + "".join(f"{k},{1.1 * k},{0.9 * k}\n" for k in range(5))
    yield Kind(
        "calibrate-cell",
        ".csv",
        [cells, channels],
        lambda path: calibrate_file(path, None, None, as_json=True),
        of_table,
    )
    dial = "tool,axis,force_N,deflection_um\n" + "".join(f"{1 + k % 2},x,{100 * k},{40 * k}\n" for k in range(8))
    yield Kind("dial", ".csv", [dial], read_dial, of_table)
    gauge = (JOBS / "praveen_cone_610_machine_error.csv").read_text(encoding="utf-8")
    yield Kind("machine-error", ".csv", [gauge], machine_error.load, of_table)
    curve = "force_N,displacement_mm\n" + "".join(f"{100 * k},{0.1 * k}\n" for k in range(6))
    yield Kind("push-curve", ".csv", [curve], read_push_curve, of_table)
    grid = [(x, y, z) for x in (0, 50, 100) for y in (0, 50) for z in (-20, 0)]
    errors = "x,y,z,ex,ey,ez\n" + "".join(f"{x},{y},{z},{x / 9},{y / 9},1\n" for x, y, z in grid)
    yield Kind("error-map", ".csv", [errors], read_error_map, of_table)
    corners = "x,y\n0,0\n10,0\n10,10\n5,15\n0,10\n"
    yield Kind("polygon", ".csv", [corners], lambda path: shapes_of([f"polygon:{path}"], "--inside"), of_table)
    points = "x,y,z,received\n" + "".join(
        f"{x / 99},{y / 99},{-x * y / 999},{x // 5}\n" for x in range(9) for y in range(9)
    )
    yield Kind("points", ".csv", [points], lambda path: load_shape(path, "mm"), of_table)
    program = "%\nG21 G90 G17 G54\nT1 M6\nG0 X0 Y0 Z5\nG1 Z-1 F600\n" + "".join(
        f"G1 X{k} Y{k % 7} Z-{k / 10:.2f}\nG2 X{k + 1} Y{k % 5} R50\n" for k in range(30)
    )
    yield Kind("program", ".nc", [program + "G4 P1\nM30\n%\n"], lambda path: read_program(program_text(path)), of_table)


def _archives(folder: Path) -> Iterator[Kind]:
    made = plan(load_job(JOBS / "mini_cone.yaml"))
    few = Plan(made.plan_id, made.contours[:2], made.target, made.mesh, ("a warning",), ball_radius=5e-3)
    whole = archive.read_archive(save_plan(few, folder / "plan.npz"))
    yield Kind("plan", ".npz", [whole], load_plan, of_arrays)
    several = np.linspace(0.0, 1e-3, 6)
    places, sample, count = np.zeros((6, 2)), np.ones((6, 4)), np.arange(6)
    learned = learning.Learned(
        "job", 3, 1, count, places, several, several, several, several, sample, several, several[:1]
    )
    learning.save(learned, folder / "learned.npz")
    yield Kind("learned", ".npz", [archive.read_archive(folder / "learned.npz")], learning.load, of_arrays)
    values = np.ones((6, len(PREDICTORS)))
    part = formed_parts.FormedPart("a", "cone", 1e-3, values, several, np.full(6, 1 / 6), 1e-4)
    conditions = formed_parts.Conditions("SPIF", "AA5754-O", 5e-3, "none", plate=False)
    formed_parts.save(formed_parts.FormedParts(conditions, (part, part)), folder / "surfaces.npz")
    surfaces = archive.read_archive(folder / "surfaces.npz")
    yield Kind("accuracy-surfaces", ".npz", [surfaces], formed_parts.load, of_arrays)
    scan = np.random.default_rng(1).uniform(-0.05, 0.05, (200, 3))
    columns = {name: scan[:, k] for k, name in enumerate("xyz")}
    yield Kind("point-arrays", ".npz", [{"points": scan}, columns], lambda path: load_shape(path, "mm"), of_arrays)


def _meshes() -> Iterator[Kind]:
    import trimesh

    cone = trimesh.creation.cone(radius=40.0, height=20.0, sections=24)
    faces = cone.faces[(cone.triangles[:, :, 2] > 1e-6).any(axis=1)]
    mesh = trimesh.Trimesh(cone.vertices * [1.0, 1.0, -1.0], faces[:, ::-1], process=True)

    def exported(kind: str, **options: Any) -> Any:
        return mesh.export(file_type=kind, **options)

    def placed(path: Path) -> Any:
        return check_and_place(load_mesh(path, None if path.suffix in (".3mf", ".step") else "mm"), CLAMP, 5e-3)

    for name, text in (
        ("stl", exported("stl_ascii")),
        ("obj", exported("obj")),
        ("off", exported("off")),
        ("ply", exported("ply", encoding="ascii").decode()),
    ):
        yield Kind(f"mesh.{name}-text", f".{name}", [text], placed, of_table)
        yield Kind(f"shape.{name}", f".{name}", [text], lambda path: load_shape(path, "mm"), of_table)
    for name in ("stl", "ply"):
        yield Kind(f"mesh.{name}", f".{name}", [exported(name)], placed, damaged_bytes)
    cloud = exported("ply", encoding="ascii").decode().partition("element face")[0] + "end_header\n"
    cloud += "\n".join(" ".join(f"{value:.6f}" for value in vertex[:3]) for vertex in mesh.vertices) + "\n"
    yield Kind("cloud.ply", ".ply", [cloud], lambda path: load_shape(path, "mm"), of_table)
    die = (JOBS / "tpif_cone.yaml").read_text(encoding="utf-8")
    text = exported("stl_ascii")
    yield Kind("die", "die.stl", [text], lambda path: read_die(_with_die(die, path)), of_table)
    with zipfile.ZipFile(io.BytesIO(exported("3mf"))) as packed:
        name = next(item for item in packed.namelist() if item.endswith(".model"))
        model = packed.read(name).decode()
    yield Kind("mesh.3mf", ".3mf", [model], placed, of_zipped_mesh)
    cad = ROOT / "ros_ws" / "src" / "isf_planner" / "test" / "part" / "data" / "cone_mm.step"
    if cad.is_file():
        yield Kind(
            "mesh.step", ".step", [cad.read_text(encoding="utf-8")], placed, of_table, share=0.1
        )  # a program each


def _with_die(job: str, die: Path) -> JobFile:
    lines = [f"  mesh: {die}" if "mesh:" in line and "_die" in line else line for line in job.splitlines()]
    return JobFile("\n".join(lines), JOBS)


@dataclass
class Found:
    """What became of the readings.

    Attributes
    ----------
    read, refused : number of files that were read and that were refused with a code
    codes : how often each code was told
    unexpected : kind, number of the input and the error, with its place
    slow, large : kind, number of the input, and s or MB
    longest : s of processor time ; memory : MB of the largest process
    """

    read: int = 0
    refused: int = 0
    codes: dict[str, int] = field(default_factory=dict)
    unexpected: list[tuple[str, int, str]] = field(default_factory=list)
    slow: list[tuple[str, int, float]] = field(default_factory=list)
    large: list[tuple[str, int, float]] = field(default_factory=list)
    longest: float = 0.0
    memory: float = 0.0
    seconds: float = 0.0

    def take(self, kind: str, number: int, outcome: str, error: str, seconds: float, memory: float) -> None:
        """Count one reading; ``outcome``: "read", a code, or "unexpected"."""
        if outcome == "read":
            self.read += 1
        elif outcome == "unexpected":
            self.unexpected.append((kind, number, error))
        else:
            self.refused += 1
            self.codes[outcome] = self.codes.get(outcome, 0) + 1
        if seconds > LONGEST:
            self.slow.append((kind, number, round(seconds, 1)))
        if memory > MOST:
            self.large.append((kind, number, round(memory)))
        self.longest, self.memory = max(self.longest, seconds), max(self.memory, memory)

    @property
    def faults(self) -> int:
        """Readings that are not as they should be."""
        return len(self.unexpected) + len(self.slow) + len(self.large)

    def rows(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "inputs": self.read + self.refused + len(self.unexpected),
            "read": self.read,
            "refused": self.refused,
            "codes": dict(sorted(self.codes.items())),
            "unexpected": self.unexpected,
            "over_5_s": self.slow,
            "over_1_GB": self.large,
            "longest_s": round(self.longest, 2),
            "largest_memory_MB": round(self.memory),
            "seconds": round(self.seconds, 1),
        }


def read_one(kind: Kind, path: Path) -> tuple[str, str]:
    """What comes of it, as of :meth:`Found.take`, and where an unexpected error is from."""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            kind.read(path)
    except IsfError as error:
        if error.code is ErrorCode.INTERNAL or not error.where:
            return "unexpected", f"{error!r} without a place" if not error.where else f"{error!r}"
        return error.code.name, ""
    except Exception as error:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "isf_" in frame.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        return "unexpected", f"{type(error).__name__} at {place}: {error}"[:300]
    return "read", ""


def reader(kind: Kind, folder: Path, jobs: Connection) -> None:
    """Process that writes what it is sent, reads it, and answers; ends at the end of ``jobs``."""
    path = folder / kind.suffix if not kind.suffix.startswith(".") else folder / f"file{kind.suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(EOFError, KeyboardInterrupt):
        while True:
            content: bytes | str = jobs.recv()
            _remove(path)
            if isinstance(content, str):
                put_strange(path, content)
            else:
                path.write_bytes(content)
            began = time.process_time()
            outcome, error = read_one(kind, path)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            jobs.send((outcome, error, time.process_time() - began, memory))


def _remove(path: Path) -> None:
    if path.is_dir():
        path.rmdir()
    path.unlink(missing_ok=True)


class Child:
    """A process that reads files of one kind, begun anew where it ended."""

    def __init__(self, kind: Kind, folder: Path) -> None:
        self._kind, self._folder = kind, folder
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("fork")
        self._jobs, other = context.Pipe()
        self._process = context.Process(target=reader, args=(self._kind, self._folder, other), daemon=True)
        self._process.start()
        other.close()

    def read(self, content: bytes | str) -> tuple[str, str, float, float]:
        """As :func:`reader` answers; one that does not has taken PATIENCE."""
        self._jobs.send(content)
        try:
            if self._jobs.poll(PATIENCE):
                answer: tuple[str, str, float, float] = self._jobs.recv()
                if answer[3] > MOST:  # the next one is not to inherit what this one took
                    self.close()
                    self._begin()
                return answer
            what, seconds = f"no answer in {PATIENCE:g} s", PATIENCE
        except (EOFError, ConnectionError):
            self._process.join()
            what, seconds = f"the process ended with {self._process.exitcode}", 0.0
        self.close()
        self._begin()
        return "unexpected", what, seconds, 0.0

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._jobs.close()


def inputs(kind: Kind, count: int, seed: int) -> Iterator[bytes | str]:
    """What is read of ``kind``: at first what is no such file, then ``count`` damaged ones; as text the names of
    STRANGE."""
    if kind.strange:
        yield from STRANGE
        if kind.suffix == ".3mf":
            yield bomb("3D/3dmodel.model")
        if kind.suffix == ".npz":
            yield bomb("points.npy")
    chance = random.Random(f"{seed} {kind.name}")
    for _ in range(count):
        yield kind.damage(chance.choice(kind.whole), chance)


def measure(count: int, seed: int, names: Sequence[str]) -> Found:
    """Read ``count`` damaged files of all kinds by their shares; ``names`` of kinds, all where there are none."""
    found, began = Found(), time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            chosen = [kind for kind in kinds(Path(scratch)) if not names or kind.name in names]
            ends = np.cumsum([0.0, *(kind.share for kind in chosen)])
            counts = np.diff(np.round(count * ends / max(ends[-1], 1e-9)).astype(int)).tolist()
            for place, kind in enumerate(chosen):
                folder = Path(scratch) / f"kind {place}"
                folder.mkdir()
                child, before, started = Child(kind, folder), found.faults, time.monotonic()
                try:
                    for number, content in enumerate(inputs(kind, counts[place], seed)):
                        found.take(kind.name, number, *child.read(content))
                finally:
                    child.close()
                now = f"{found.faults - before} faults, {time.monotonic() - started:.0f} s"
                print(f"{place + 1} of {len(chosen)}: {kind.name}, {now}", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            print("ended by Ctrl-C", file=sys.stderr)
    found.seconds = time.monotonic() - began
    return found


def main() -> None:
    """Measure and print; exit code 1 for any fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000, help="damaged files, beside those that are none")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--kinds", nargs="+", default=[], help="names of kinds; all where they are left out")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background of a shell ignores it
    found = measure(arguments.count, arguments.seed, arguments.kinds)
    rows = found.rows()
    if arguments.json:
        print(json.dumps(rows, indent=1))
    else:
        print(f"{rows['inputs']} files: {found.read} read, {found.refused} refused with {len(found.codes)} codes")
        print(f"unexpected {len(found.unexpected)}, over 5 s {len(found.slow)}, over 1 GB {len(found.large)}")
        for kind, number, what in (*found.unexpected, *found.slow, *found.large)[:SHOWN]:
            print(f"  {kind}, number {number}: {what}")
        print(f"longest {found.longest:.2f} s, largest memory {found.memory:.0f} MB, {found.seconds:.0f} s in all")
    raise SystemExit(1 if found.faults else 0)


if __name__ == "__main__":
    main()
