"""The tables of the manual are in step with the sources: fields of files, parameters of nodes, error codes, links."""

from __future__ import annotations

import re
import runpy
import subprocess
from pathlib import Path
from urllib.parse import unquote

import pytest
from isf_core.errors import ErrorCode

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TABLES = runpy.run_path(str(ROOT / "scripts" / "field_tables.py"))
OUTSIDE = ["README.md", "CONTRIBUTING.md", *(f"{path}" for path in ROOT.glob("ros_ws/src/*/README.md"))]
"""Pages that the site does not hold and its build does not check."""


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: str(path.relative_to(DOCS)))
def test_tables_of_fields_are_in_step(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert TABLES["filled"](text) == text, "run ./isf python scripts/field_tables.py"


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: str(path.relative_to(DOCS)))
def test_no_page_says_a_thing_twice(path: Path) -> None:
    prose = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    said = [part for part in re.split(r"\n\s*\n", prose) if len(part) > 80 or part.startswith("#")]
    assert not {part for part in said if said.count(part) > 1}


def test_parameter_files_are_in_step() -> None:
    files = TABLES["parameter_files"]()
    assert len(files) == 9
    for path, text in files.items():
        assert path.read_text(encoding="utf-8") == text, "run ./isf python scripts/field_tables.py"
        assert 'glob("config/*.yaml")' in (path.parents[1] / "setup.py").read_text(encoding="utf-8")


def test_every_field_and_parameter_says_what_it_means() -> None:
    for name in ("job", "rigs_and_materials", "nodes"):
        text = (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8")
        assert not re.findall(r"^\| `.*\|  \|$", text, flags=re.MULTILINE)


def test_the_tables_of_files_tell_the_ranges_that_are_refused_outside() -> None:
    job, rig = (
        (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8") for name in ("job", "rigs_and_materials")
    )
    assert "| `rate` | frequency | `500 Hz` | 100 .. 2000 Hz |" in job
    assert "| `support_force` | `auto` or force | `0 N` | 0 .. 1500 N |" in job  # in a type within another one
    assert "| `engage_wall_angle` | angle | `15 deg` | >= 0 and < 90 deg |" in job  # no end of it where it is excluded
    assert "| `contact_stiffness` | stiffness | needed | > 0 N/um |" in rig
    assert "| `method` | text | `auto` | - |" in job


def test_the_page_of_error_codes_names_all_of_them() -> None:
    text = (DOCS / "reference" / "error_codes.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (\w+) \| (.+) \| (.+) \|$", text, flags=re.MULTILINE)
    assert [(int(code), name) for code, name, _, _ in rows] == [(int(c), c.name) for c in ErrorCode if c]


def test_every_error_code_is_in_a_test() -> None:
    tests = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("ros_ws/src/*/test/**/*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in tests)
    assert [code.name for code in ErrorCode if code and not re.search(rf"\b({code.name}|{int(code)})\b", text)] == []


@pytest.mark.parametrize("name", OUTSIDE, ids=lambda name: str(Path(name).parent.name or name))
def test_links_of_pages_outside_the_site_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, anchor = target.partition("#")
        if path.startswith("http"):
            continue
        found = page.parent / unquote(path) if path else page
        assert found.exists(), f"{name}: {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", text).lower().replace(" ", "-") for text in headings}, target


def test_pages_that_sources_name_exist() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        path = ROOT / name
        if path.suffix not in {".py", ".yaml", ".sh", ".toml", ".md"} or not path.is_file():
            continue
        for page in re.findall(r"\bdocs/[\w/]+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / page).is_file(), f"{name} names {page}"


MODULE = re.compile(r"`(isf_\w+(?:\.\w+)+)`|`([\w/]+\.py)`")


def _exists(name: str) -> bool:
    """A module, or a name in one; of the packages of the workspace."""
    first, *rest = name.split(".")
    folder = ROOT / "ros_ws" / "src" / first / first
    for n in range(len(rest), -1, -1):
        path = folder.joinpath(*rest[:n])
        source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if source.is_file():
            return n == len(rest) or re.search(rf"\b{rest[n]}\b", source.read_text(encoding="utf-8")) is not None
    return False


def test_modules_that_pages_name_exist() -> None:
    files = {
        path.name
        for folder in ("ros_ws/src", "benchmarks", "tests", "scripts")
        for path in ROOT.glob(f"{folder}/**/*.py")
    }
    pages = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", *sorted(ROOT.glob("ros_ws/src/*/README.md"))]
    unknown = [
        f"{page.relative_to(ROOT)}: {module or file}"
        for page in pages
        for module, file in MODULE.findall(page.read_text(encoding="utf-8"))
        if not (_exists(module) if module else Path(file).name in files)
    ]
    assert not unknown
