"""The table of a campaign: a row for each kind of fault, and which of its goals it misses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from isf_cell.faults.campaign import BRAKING, HELD, OVER_LIMIT, RELEASED, Case
from isf_cell.faults.kinds import KINDS, FaultKind


@dataclass(frozen=True)
class Row:
    """All cases of one kind."""

    kind: FaultKind
    cases: tuple[Case, ...]

    @property
    def held(self) -> float | None:
        """s, 99th percentile until the forming tool stood; None: no part ended."""
        return _share([case.held for case in self.cases], 0.99)

    @property
    def reaction(self) -> float | None:
        """s, 99th percentile of the same without braking."""
        return _share([case.reaction for case in self.cases], 0.99)

    @property
    def released(self) -> float | None:
        """s, longest until no tool carried a force; None: no part ended, or nobody measured."""
        return _share([case.released for case in self.cases], 1.0)

    @property
    def resumed(self) -> tuple[int, int]:
        """Parts that were gone on with, and those that had to be."""
        tried = [case.resumed for case in self.cases if case.resumed is not None]
        return sum(tried), len(tried)

    @property
    def worst(self) -> float:
        """Largest force as a share of the limit."""
        return max((case.worst for case in self.cases), default=0.0)

    @property
    def misses(self) -> list[str]:
        """Goals that were not reached, in words; empty: all were."""
        return list(self._missed())

    def _missed(self) -> Iterator[str]:
        cases = self.cases
        not_done = sum(case.load == 0.0 for case in cases)
        if not_done:
            yield f"{not_done} not injected"
        if self.reaction is not None and self.reaction > self.kind.known_after + HELD:
            yield f"held after {_seconds(self.reaction)}"
        if self.released is not None and self.released > self.kind.known_after + RELEASED:
            yield f"force for {_seconds(self.released)}"
        wrong = sorted({case.code for case in cases if not case.right and case.load})
        if wrong:
            yield "told " + ", ".join(map(str, wrong))
        resumed, tried = self.resumed
        if resumed < tried:
            yield f"{tried - resumed} not resumed"
        if count := sum(case.wrong_success for case in cases):
            yield f"{count} wrong success"
        if count := sum(case.lost for case in cases):
            yield f"{count} results lost"
        if self.worst > OVER_LIMIT:
            yield f"{100 * self.worst:.0f} % of the force limit"

    def as_dict(self) -> dict[str, Any]:
        """For JSON: times in s, NaN and infinity where there is no number."""
        resumed, tried = self.resumed
        return {
            "kind": self.kind.name,
            "how": self.kind.text,
            "lockstep": self.kind.lockstep,
            "injected": sum(case.load > 0.0 for case in self.cases),
            "held_p99_s": self.held,
            "reaction_p99_s": self.reaction,
            "held_within_50ms": sum(case.reaction is not None and case.reaction <= HELD for case in self.cases),
            "ended": sum(case.held is not None for case in self.cases),
            "released_max_s": self.released,
            "diagnosed": sum(case.right for case in self.cases),
            "codes": sorted({case.code for case in self.cases}),
            "resumed": resumed,
            "to_resume": tried,
            "wrong_successes": sum(case.wrong_success for case in self.cases),
            "results_lost": sum(case.lost for case in self.cases),
            "worst_force_share": self.worst,
            "misses": self.misses,
        }


def rows_of(cases: Sequence[Case]) -> list[Row]:
    """In the order of the catalogue; kinds without a case are left out."""
    rows = [Row(kind, tuple(case for case in cases if case.kind == kind.name)) for kind in KINDS]
    return [row for row in rows if row.cases]


HEAD = (
    "kind",
    "what is done",
    "time",
    "injected",
    "held, p99 [ms]",
    "stands, p99 [ms]",
    "released, max [s]",
    "diagnosed",
    "resumed",
    "wrong successes",
    "results lost",
    "worst force [% of limit]",
    "misses",
)


def cells_of(row: Row) -> tuple[str, ...]:
    """One line of the table, for people."""
    data, count = row.as_dict(), len(row.cases)
    resumed, tried = row.resumed
    codes = ", ".join(map(str, data["codes"]))
    return (
        row.kind.name,
        row.kind.text,
        "lockstep" if row.kind.lockstep else "clock",
        str(data["injected"]),
        "-" if row.reaction is None else _number(1e3 * row.reaction, 0),
        "-" if row.held is None else _number(1e3 * row.held, 0),
        "-" if row.released is None else _number(row.released, 2),
        f"{data['diagnosed']} of {count} ({codes})",
        f"{resumed} of {tried}" if tried else "-",
        str(data["wrong_successes"]),
        str(data["results_lost"]),
        f"{100 * row.worst:.0f}",
        "; ".join(row.misses) or "-",
    )


def page_of(rows: Sequence[Row], *, seed: int, load: float, cores: int) -> str:
    """The campaign as a Markdown page."""
    count = sum(len(row.cases) for row in rows)
    good = sum(not row.misses for row in rows)
    lines = [
        "# Fault campaign",
        "",
        f"{count} faults of {len(rows)} kinds, seed {seed}; {good} kinds reach every goal. Simulated machine, sheet "
        f"`fast`, a cone of three contours; load of the computer at the end {load:.1f} on {cores} processors.",
        "",
        f"Goals: the forming tool is held within {1e3 * HELD:.0f} ms (99th percentile), no tool carries a force "
        f"{RELEASED:.0f} s after, the part ends with a code that names the cause or goes on undisturbed, it can be "
        f"resumed, no result is lost, no force above {100 * OVER_LIMIT:.0f} % of the limit.",
        "",
        "Stands: by the machine's time where its messages are altered, else by the wall clock, judged upwards to the "
        "distance of two poses (10 ms; in cells of a command 20 ms); what a process that is frozen lacks in signs of "
        "life is known after 5 s, and the goals count from then on; 0 where the machine tells nothing any more. Held: "
        "the same without the time in "
        f"which force control brakes with {BRAKING:g} m/s^2, where it did. Released: by the wall clock.",
        "",
        "| " + " | ".join(HEAD) + " |",
        "|" + "---|" * len(HEAD),
        *("| " + " | ".join(cells_of(row)) + " |" for row in rows),
        "",
    ]
    return "\n".join(lines)


def _share(values: Sequence[float | None], share: float) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.quantile(known, share, method="higher")) if known else None


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "never"


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if math.isfinite(value) else "ever"
