"""Every source that is cited stands in the bibliography; no reference is to a document that a reader does not have."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BIBLIOGRAPHY = ROOT / "docs" / "reference" / "bibliography.md"
TEXTS = {".py", ".md", ".yaml", ".msg", ".srv", ".action", ".xml", ".sh", ".toml"}
NO_SOURCES = re.compile(
    r"January|February|March|April|May|June|July|August|September|October|November|December|CPython|University"
)

CITATION = re.compile(r"\b((?:[A-Z][\w-]+ and )?[A-Z][\w-]+)(?: et al\.)?,? \(?((?:19|20)\d\d)\b")
"""Ren 2018; Aerens et al. 2009; Kaufman and Rousseeuw 1990; Pratt (1987)."""

CODES = re.compile(
    r"\b[A-Z]-\d+\.\d+\b"  # O-2.10
    r"|\btraps? [A-Z]-?\d"
    r"|(?:#|\"\"\")\s*[A-Z]-?\d{1,2}(?:\.\d+)?[:,] "  # a comment that begins with P17:
    r"|\b(?:Ren|Lu|Praveen|Behera|Torrao)\b[^.;\n]{0,20}\b(?:EX|[A-H])\d{1,2}\b"
    r"|\bspecification,? \d+\.\d"
    r"|§"
)
"""Labels of the notes that a source was read with, which are not part of it."""


def _texts() -> list[Path]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [ROOT / name for name in listed.splitlines()]
    return [path for path in files if path.suffix in TEXTS and path != Path(__file__) and path.is_file()]


def _entries() -> set[str]:
    return set(re.findall(r"^### (.+)$", BIBLIOGRAPHY.read_text(encoding="utf-8"), flags=re.MULTILINE))


def _cited(text: str) -> set[str]:
    found = {f"{names} {year}" for names, year in CITATION.findall(text)}
    return {name for name in found if not NO_SOURCES.search(name)}


def test_every_citation_is_in_the_bibliography() -> None:
    entries = _entries()
    unknown = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in _texts()
        if path != BIBLIOGRAPHY
        for name in _cited(path.read_text(encoding="utf-8"))
        if name not in entries
    }
    assert not unknown


def test_references_are_to_what_a_reader_can_find() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in _texts()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if CODES.search(line)
    ]
    assert not found


def test_the_search_finds_what_it_is_for() -> None:
    assert _cited("Ren 2018 eq. 2-8; Aerens et al. 2009, Kaufman and Rousseeuw 1990; Pratt (1987); in May 2018") == {
        "Ren 2018",
        "Aerens 2009",
        "Kaufman and Rousseeuw 1990",
        "Pratt 1987",
    }
    for text in ("# O-2.10: contact", '"""P17: down"""', "trap H2", "Lu 2016, EX3", "# F-2.31, 7.2"):
        assert CODES.search(text), text
    for text in ("M30", "tool_1", "Ren 2018 eq. 2-8", "O-ring", "Appendix C: X 42.5714", "ISO 6983"):
        assert not CODES.search(text), text
