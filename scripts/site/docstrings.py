"""Extension of griffe: docstrings of the sources as Markdown.

Sections are underlined (``Parameters``, ``Returns``, ``Raises``, ``Attributes``) and hold lines ``name : text``, the
unit first; references to other code are roles (:func:`f`). Both become lists and code words.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Docstring, Extension, Object

SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}\n((?:.+\n?)*)", re.MULTILINE)
ENTRY = re.compile(r"^(\*{0,2}\w[\w.,* ]*?) : (.*)$")
ROLE = re.compile(r":(?:py:)?(?:func|class|mod|meth|attr|data):`~?([^`]+)`")


def as_markdown(text: str) -> str:
    """``text`` with lists for sections and code for roles."""
    return SECTION.sub(_section, ROLE.sub(r"`\1`", text))


def _section(match: re.Match[str]) -> str:
    lines = []
    for line in match[2].splitlines():
        entry = ENTRY.match(line)
        if entry:
            lines.append(f"* `{entry[1]}`: {entry[2]}")
        elif line.startswith(" ") and lines:
            lines[-1] += " " + line.strip()
        else:
            lines.append(f"* {line}")
    return f"**{match[1]}**\n\n" + "\n".join(lines) + "\n"


class MarkdownDocstrings(Extension):
    """Rewrites every docstring once, when its object has been read."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Called for modules, classes, functions and attributes."""
        if isinstance(obj.docstring, Docstring):
            obj.docstring.value = as_markdown(obj.docstring.value)
