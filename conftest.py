"""For every test: Ctrl-C works, also where the run is a job in the background of a shell; examples repeat."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import settings

# The same examples in every run, so that a change is judged by what it changes; new ones are looked for with
# --hypothesis-profile=random, as ./test.sh --slow does. No deadline: how long an example takes is the computer's load.
settings.register_profile("random", deadline=None)
settings.register_profile("repeated", deadline=None, derandomize=True)
settings.load_profile("repeated")

# Such a job ignores SIGINT, and so would every process that a test starts and ends with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Side by side, each worker has a ROS domain of its own.
worker = os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw")
domains = os.environ.get("ISF_TEST_DOMAINS", "").split()
if worker and domains:
    os.environ["ROS_DOMAIN_ID"] = domains[int(worker) % len(domains)]

# colcon test runs packages side by side, in whatever domain its shell has, which may be that of a running cell.
of_colcon = "COLCON" in os.environ
if of_colcon:
    free = [sys.executable, str(Path(__file__).parent / "scripts" / "free_domain.py")]
    os.environ["ROS_DOMAIN_ID"] = subprocess.check_output(free, text=True).strip()


def pytest_configure(config: pytest.Config) -> None:
    """Tests that take minutes are left out by colcon test too, as long as it is not given marks."""
    if of_colcon and not config.option.markexpr:
        config.option.markexpr = "not slow"


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file without a test of the marks that ./test.sh asks for is not imported: ten processes would do it in vain.

    Marks stand in the file of their test (tests/repository/test_marks.py).
    """
    wanted = MARKS.get(str(config.option.markexpr).removesuffix(" and not slow"))
    if wanted is None or not collection_path.name.startswith("test_") or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if wanted(text) else True


MARKS: dict[str, Callable[[str], bool]] = {
    "graph and clock": lambda text: "mark.graph" in text and "mark.clock" in text,
    "graph and not clock": lambda text: "mark.graph" in text,
    "not graph": lambda text: not re.search(r"^pytestmark = .*mark\.graph", text, re.MULTILINE),
}


@pytest.fixture(scope="module")
def forked_nodes() -> Iterator[None]:
    """A ProcessGroup in this process starts its nodes without the imports of a new interpreter."""
    import forked_process
    from isf_cell.processes import process_group

    of_module = {name: getattr(subprocess, name) for name in ("DEVNULL", "STDOUT", "TimeoutExpired")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process_group, "subprocess", SimpleNamespace(Popen=forked_process.node_of_group, **of_module))
        yield


def pytest_sessionfinish() -> None:
    """No process of a test outlives the run."""
    made = sys.modules.get("forked_process")
    if made is not None:
        made.close()


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--exact`` of tests/golden."""
    parser.addoption("--exact", action="store_true", help="golden runs: the same bit for bit, on the same computer")
