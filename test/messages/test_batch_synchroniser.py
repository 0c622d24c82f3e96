"""Messages joined batch by batch: the samples and losses of messages pushed one by one."""

from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.test_synchroniser import stalled
from numpy.testing import assert_array_equal

from tam_calibration.messages.batch_synchroniser import BatchSynchroniser
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.samples import StreamMessages
from tam_calibration.messages.synchroniser import Synchroniser

MS = 1_000_000
PERIOD = 10 * MS
PATIENCE = 100 * MS
SILENCE = 150 * MS
ALL = SampleLayout(3, ("scalar", "temperature", "current", "attitude", "actuator_rudder"))
WIDTH = {"scalar": 1, "temperature": 1, "current": 1, "attitude": 4, "actuator_rudder": 1}


def make(kind, tolerance_ns, **options):
    """Make a synchroniser as for bags, with little patience."""
    return kind(ALL, tolerance_ns, PATIENCE, PATIENCE, expected=ALL.channels, capacity=1 << 30, **options)


def one_by_one(messages, tolerance_ns, **options):
    """Return stamps, values and the synchroniser after messages pushed one by one."""
    synchroniser = make(Synchroniser, tolerance_ns, **options)
    samples = [sample for one in messages for sample in synchroniser.push(*one)] + synchroniser.flush()
    return [sample.stamp_ns for sample in samples], [sample.values for sample in samples], synchroniser


def to_batch(messages):
    """Return messages as a batch."""
    streams = {}
    for order, (name, stamp, values, *arrived) in enumerate(messages):
        streams.setdefault(name, []).append((order, stamp, values, *(arrived or [0])))
    batch = {}
    for name, rows in streams.items():
        order, stamps, values, arrived = zip(*rows, strict=True)
        stamps = None if stamps[0] is None else np.array(stamps, dtype=np.int64)
        batch[name] = StreamMessages(
            np.array(order, dtype=np.int64), stamps, np.array(values), np.array(arrived, dtype=np.int64)
        )
    return batch


def in_batches(random, messages, tolerance_ns, smallest, largest, **options):
    """Return stamps, values and the synchroniser after messages pushed in batches of random size."""
    synchroniser = make(BatchSynchroniser, tolerance_ns, **options)
    parts, first = [], 0
    while first < len(messages):
        size = random.randint(smallest, largest)
        parts.append(synchroniser.push_batch(to_batch(messages[first : first + size])))
        first += size
    parts.append(synchroniser.flush_batch())
    stamps, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    return stamps, values, synchroniser


def rough(random, loss, jitter_ns, lag_ns, unstamped, restarts, false=0.0, outages=0):
    """Make all streams' messages, with jitter, losses, outages, repeats, steps, lags, false stamps, as they arrive."""
    arrivals = []
    rounds = [random.randint(30, 120) for _ in range(1 + restarts)]
    for name in (*(f"tam_{sensor}" for sensor in (1, 2, 3)), *ALL.channels):
        every = 1 if name.startswith("tam") else random.choice((1, 1, 3, 40))
        doubled = name in unstamped and random.random() < 0.5
        clock, latest, rank = 0, 0, random.random()
        silent = [(first := random.randint(-20, 100), first + random.randint(10, 90)) for _ in range(outages)]
        for length in rounds:
            for index in range(0, length, every):
                fate = 0.0 if any(first <= index < last for first, last in silent) else random.random()
                stamps = [index * PERIOD + random.randint(0, jitter_ns)] * (fate > loss)
                if fate > 1 - loss:
                    stamps.append(stamps[0] - random.choice((0, MS)))
                if random.random() < false:
                    stamps = [random.choice((0, 10**18, max(stamp - 10**9, 0), stamp + 10**9)) for stamp in stamps]
                for stamp in stamps * (1 + doubled):
                    latest = max(latest, clock + index * PERIOD + random.randint(0, lag_ns))
                    values = tuple(random.random() for _ in range(WIDTH.get(name, 3)))
                    arrivals.append((latest, rank, (name, None if name in unstamped else stamp, values)))
            clock += length * PERIOD
    return [message for _, _, message in sorted(arrivals, key=lambda one: one[:2])]


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.02, 0.3]),
    jitter_ns=st.sampled_from([0, 1, 2 * MS, 9 * MS]),
    lag_ns=st.sampled_from([0, 40 * MS, 80 * MS, 300 * MS]),
    tolerance_ns=st.sampled_from([0, 1 * MS, 4 * MS, 15 * MS]),
    unstamped=st.sets(st.sampled_from(["scalar", "current"])),
    restarts=st.sampled_from([0, 0, 0, 2]),
    delay_s=st.sampled_from([None, np.array([1e-3, 0.0, -7e-3]), np.array([0.0, 0.0, 0.0, 12e-3])]),
    false=st.sampled_from([0.0, 0.0, 0.01]),
    outages=st.sampled_from([0, 0, 1, 2]),
)
def test_batches_give_what_single_messages_give(
    seed, loss, jitter_ns, lag_ns, tolerance_ns, unstamped, restarts, delay_s, false, outages
):
    """Same samples and losses however batches are cut while no stream lags beyond the patience; in one, always."""
    random = Random(seed)
    messages = rough(random, loss, jitter_ns, lag_ns, unstamped, restarts, false, outages)
    options = {"scalar_is_held": "scalar" in unstamped, "delay_s": delay_s, "silence_ns": SILENCE}
    stamps, values, single = one_by_one(messages, tolerance_ns, **options)
    for largest in (len(messages), *((40, 400) if lag_ns < PATIENCE and not restarts else ())):
        smallest = largest if largest == len(messages) else 1
        again, again_values, batched = in_batches(random, messages, tolerance_ns, smallest, largest, **options)
        assert again.tolist() == stamps
        assert_array_equal(again_values, np.array(values).reshape(again_values.shape))
        assert batched.losses == single.losses
        assert batched.explain_losses() == single.explain_losses()
        assert batched.usage == single.usage
        assert (batched.delivered, batched.partial) == (single.delivered, single.partial)
        assert batched.restarts == single.restarts
        assert batched.steps == single.steps


def test_a_steady_recording_is_joined_in_batches(monkeypatch):
    """Nothing of a steady recording goes through message by message but what waits at its end."""
    messages = rough(Random(1), 0.02, 2 * MS, 40 * MS, {"current"}, 0)
    monkeypatch.setattr(BatchSynchroniser, "push", None)
    stamps, _, synchroniser = in_batches(Random(2), messages, 4 * MS, 100, 100)
    assert len(stamps) == synchroniser.delivered > 20


@pytest.mark.parametrize(("chunk", "largest"), [(1, 3000), (256, 40), (256, 300), (2000, 10_000)])
def test_a_burst_after_a_stall_is_joined_in_batches_too(chunk, largest):
    """However batches are cut, as message by message."""
    names = [*ALL.channels, *(f"tam_{sensor}" for sensor in (2, 3, 1))]
    messages = [
        (name, stamp, (0.5,) * WIDTH.get(name, 3), arrived)
        for name, stamp, _, arrived in stalled(names, 100, 400, chunk, 100 * MS)
    ]
    stamps, values, single = one_by_one(messages, MS)
    assert single.delivered == 700
    again, again_values, batched = in_batches(Random(1), messages, MS, largest, largest)
    assert again.tolist() == stamps
    assert_array_equal(again_values, np.array(values).reshape(again_values.shape))
    assert batched.losses == single.losses and batched.usage == single.usage


def test_the_usual_patience_is_back_after_a_stall():
    """A scalar that dies long after it holds up samples for no longer than the patience, in batches too."""
    names = [*(f"tam_{sensor}" for sensor in (2, 3, 1)), "scalar"]
    messages = [
        (name, stamp, (0.5,) * WIDTH.get(name, 3), arrived)
        for index, (name, stamp, _, arrived) in enumerate(stalled(names, 200, 1200, 256, 100 * MS))
        if name != "scalar" or index < 5200
    ]
    *_, single = one_by_one(messages, MS)
    synchroniser = make(BatchSynchroniser, MS)
    for first in range(0, len(messages), 100):
        synchroniser.push_batch(to_batch(messages[first : first + 100]))
    assert synchroniser.delivered >= single.delivered - PATIENCE // PERIOD - 1
