"""Print ROS domain ids between 1 and 101 whose UDP ports nobody on this computer uses: ``free_domain.py [COUNT]``.

Discovery and data of domain ``d`` use the UDP ports from 7400 + 250 d on (DDSI-RTPS 2.2, section 9.6.1.1). Above
101 these ports run into those that Linux gives to outgoing connections.
"""

from __future__ import annotations

import random
import sys
from pathlib import Path

PORT_BASE, PORTS_PER_DOMAIN = 7400, 250


def used_domains(tables: tuple[str, ...] = ("/proc/net/udp", "/proc/net/udp6")) -> set[int]:
    """Domains with at least one bound UDP port."""
    used = set()
    for table in map(Path, tables):
        lines = table.read_text().splitlines()[1:] if table.exists() else []
        for line in lines:
            port = int(line.split()[1].rsplit(":", 1)[1], 16)
            if port >= PORT_BASE:
                used.add((port - PORT_BASE) // PORTS_PER_DOMAIN)
    return used


def main(count: int = 1) -> None:
    """Print ``count`` free domains, drawn at random so that two runs started together differ."""
    free = sorted(set(range(1, 102)) - used_domains())
    print(*random.sample(free if len(free) >= count else range(1, 102), count))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
