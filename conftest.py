"""For every test: Ctrl-C works, also where the run is a job in the background of a shell; examples repeat."""

import signal

import pytest
from hypothesis import settings

# The same examples in every run, so that a change is judged by what it changes; new ones are looked for with
# --hypothesis-profile=random, as ./test.sh --slow does.
settings.register_profile("random", settings())
settings.register_profile("repeated", derandomize=True)
settings.load_profile("repeated")

# Such a job ignores SIGINT, and so would every process that a test starts and ends with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--exact`` of tests/golden."""
    parser.addoption("--exact", action="store_true", help="golden runs: the same bit for bit, on the same computer")
