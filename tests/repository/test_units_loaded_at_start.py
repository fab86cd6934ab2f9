"""Nodes that read a job while they work load the units before they exist: 0.2 s then, none while a part is begun."""

from __future__ import annotations

import importlib
from contextlib import suppress
from typing import Any

import pytest
from isf_core.files import quantity


@pytest.mark.parametrize("package", ["isf_force_ctrl", "isf_springback"])
def test_units_are_there_before_the_node_is(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(f"{package}.node")
    known: list[int] = []

    def run(*_: Any, **__: Any) -> int:
        known.append(quantity._registry.cache_info().currsize)
        return 0

    monkeypatch.setattr(module.process, "run", run)
    quantity._registry.cache_clear()
    with suppress(SystemExit):
        module.main()
    assert known == [1]
