"""Base of all file models: frozen, strict about unknown fields, with provenance of constants."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class FileModel(BaseModel):
    """A part of a YAML file; unknown fields are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)
