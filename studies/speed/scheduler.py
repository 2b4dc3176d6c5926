"""Simulation of an ensemble on many ranks: its scheduling of tasks, event by event.

No command; for the question in which order tasks are given out (`run_order`).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# As in src/ensemble : operations on the task queue for one task
# and for one query, bytes of the list for a task, seconds between two queries of a rank, the most
# queries per second of all ranks, the share of the time for queries, and the longest time between
# two.
OPERATIONS_A_TASK = 5
OPERATIONS_A_POLL = 2
BYTES_A_TASK = 8
POLL_INTERVAL = 0.1
POLLS_A_SECOND = 1.0e4
POLL_SHARE = 0.005
LONGEST_POLL_INTERVAL = 5.0

ORDERS = ("longest", "random", "static")


@dataclass(frozen=True)
class Network:
    """Seconds for an operation on the task queue.

    Attributes
    ----------
    latency : for the message to the queue and back.
    service : at the queue, which serves only one operation at a time.
    """

    latency: float = 5.0e-6
    service: float = 1.0e-6


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes
    ----------
    seconds : from the start to the end of the last task.
    idle_share : share of all ranks' time not spent in tasks.
    queue_share : part of it spent for operations on the queue: latency, waiting, and queries.
    end_share : part of it spent waiting for the last task of the run.
    busy_least : share of its time that the least busy rank spends in tasks.
    queue_load : share of the time in which the queue serves an operation.
    longest_wait : longest time a rank waits for its next task.
    list_bytes : memory of the list of tasks, on rank 0 only.
    """

    seconds: float
    idle_share: float
    queue_share: float
    end_share: float
    busy_least: float
    queue_load: float
    longest_wait: float
    list_bytes: int


def task_lengths(tasks: int, mean: float, spread: float, seed: int) -> Floats:
    """Return log-normal lengths of so many tasks, in seconds.

    Parameters
    ----------
    spread : standard deviation over the mean.
    """
    sigma = np.sqrt(np.log1p(spread**2))
    normal = np.random.default_rng(seed).standard_normal(tasks)
    return mean * np.exp(sigma * normal - 0.5 * sigma**2)


def put_in_order(lengths: Floats, order: str, length_error: float, seed: int) -> Floats:
    """Return the tasks in the order of the list.

    Parameters
    ----------
    order : `longest`: by decreasing expected length; else unchanged.
    length_error : relative error (log-normal) of the expected lengths.
    """
    if order != "longest":
        return lengths
    expected = lengths * task_lengths(len(lengths), 1.0, length_error, seed + 1)
    return lengths[np.argsort(-expected, kind="stable")]


def simulate(lengths: Floats, ranks: int, network: Network) -> Outcome:
    """Assign the tasks, in this order, to the ranks, one by one from the queue."""
    work, queue_time, load = _slowed(lengths, ranks, network)
    service = OPERATIONS_A_TASK * network.service / max(1.0 - load, 1e-9)
    latency = OPERATIONS_A_TASK * network.latency
    # (time at which a rank's request arrives at the queue, rank); the queue is free again at
    # `free`.
    coming = [(0.0, rank) for rank in range(ranks)]
    spent = np.zeros(ranks)
    free = longest_wait = last = 0.0
    for length in work.tolist():
        now, rank = coming[0]
        served = max(now, free) + service
        free = served
        got = served + latency
        longest_wait = max(longest_wait, got - now)
        end = got + length
        last = max(last, end)
        spent[rank] += length
        heapq.heapreplace(coming, (end, rank))
    finished = np.zeros(ranks)
    for end, rank in coming:
        finished[rank] = end
    total = ranks * last
    busy = float(lengths.sum())
    end_share = float((last - finished).sum()) / total
    return Outcome(
        seconds=last,
        idle_share=1.0 - busy / total,
        queue_share=1.0 - busy / total - end_share,
        end_share=end_share,
        busy_least=float(spent.min()) / last * busy / float(work.sum()),
        queue_load=(OPERATIONS_A_TASK * network.service * len(lengths) + queue_time) / last,
        longest_wait=longest_wait,
        list_bytes=BYTES_A_TASK * len(lengths),
    )


def _slowed(lengths: Floats, ranks: int, network: Network) -> tuple[Floats, float, float]:
    """Return the lengths with queries of the queue, the time of the queries, and their load."""
    cost = OPERATIONS_A_POLL * (network.latency + network.service)
    interval = max(POLL_INTERVAL, ranks / POLLS_A_SECOND, cost / POLL_SHARE)
    polls = np.floor(lengths / min(interval, LONGEST_POLL_INTERVAL))
    queue_time = float(polls.sum()) * OPERATIONS_A_POLL * network.service
    seconds = float(lengths.sum()) / min(ranks, len(lengths))
    return lengths + cost * polls, queue_time, min(queue_time / seconds, 1.0)


def simulate_static(lengths: Floats, ranks: int) -> Outcome:
    """Assign the tasks beforehand, equally many to each rank, as a shell loop does."""
    shares = np.zeros(ranks)
    np.add.at(shares, np.arange(len(lengths)) % ranks, lengths)
    last = float(shares.max())
    idle = 1.0 - float(shares.mean()) / last
    return Outcome(last, idle, 0.0, idle, float(shares.min()) / last, 0.0, 0.0, 0)


def run_order(
    lengths: Floats, ranks: int, network: Network, order: str, length_error: float
) -> Outcome:
    """Schedule the tasks in one of the `ORDERS`."""
    if order == "static":
        return simulate_static(lengths, ranks)
    return simulate(put_in_order(lengths, order, length_error, 0), ranks, network)
