"""The last seconds of a cell: what is held, what goes, what holds from before."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from isf_analysis.bag.ring import Ring

STREAM, LATCHED = 0, 1
ARRIVALS = st.lists(st.tuples(st.sampled_from([STREAM, LATCHED]), st.integers(0, 50), st.integers(0, 30)), max_size=60)


@given(ARRIVALS, st.integers(0, 200), st.integers(0, 400))
def test_the_span_is_held_and_the_last_of_a_latched_topic(
    arrivals: list[tuple[int, int, int]], span: int, room: int
) -> None:
    ring = Ring(span, room, {LATCHED})
    time, sent = 0, []
    for number, after, size in arrivals:
        time += after
        sent.append((number, time, bytes(size)))
        ring.add([sent[-1]])
    within = [message for message in sent if message[1] >= time - span]
    while sum(len(data) for _, _, data in within) > room:
        within = within[1:]
    found = ring.messages()
    assert found[len(found) - len(within) :] == within
    before = found[: len(found) - len(within)]
    older = [message for message in sent[: len(sent) - len(within)] if message[0] == LATCHED]
    assert [(number, data) for number, _, data in before] == [(number, data) for number, _, data in older[-1:]]
    assert [message[1] for message in found] == sorted(message[1] for message in found)


def test_a_ring_without_messages_is_empty() -> None:
    assert Ring(10, 10, {LATCHED}).messages() == []


def test_all_that_several_nodes_told_of_a_joint_topic_is_held_once() -> None:
    ring = Ring(10, 1000, {LATCHED}, {LATCHED})
    ring.add([(LATCHED, 1, b"clamp"), (LATCHED, 2, b"robot"), (LATCHED, 3, b"clamp"), (STREAM, 50, b"wrench")])
    assert ring.messages() == [(LATCHED, 50, b"robot"), (LATCHED, 50, b"clamp"), (STREAM, 50, b"wrench")]
    ring.add([(LATCHED, 60 + k, b"%d" % k) for k in range(150)])
    assert len(ring.messages()) == 100 + 11  # the last hundred, and what the span holds
