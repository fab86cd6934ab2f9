"""What a page with a picture in three dimensions holds: its data are packed in it."""

from __future__ import annotations

import base64
import gzip
import json
import re
from typing import Any

_DATA = re.compile(r"data-view3d>([A-Za-z0-9+/=]+)</script>")


def text_of(html: str) -> str:
    """The data of the only picture of a page, as JSON."""
    (packed,) = _DATA.findall(html)
    return gzip.decompress(base64.b64decode(packed)).decode()


def unpacked(html: str) -> dict[str, Any]:
    """The same, read."""
    content: dict[str, Any] = json.loads(text_of(html))
    return content
