"""A CAN bus simulated bit by bit, to hold against the response-time analysis."""

import heapq
from math import inf


def simulate(queued, lengths):
    """Non-pre-emptive fixed priority: when each frame that was queued is through.

    Args:
        queued: (time, priority, instance) of each, in whole units of time.
        lengths: by priority, what a frame takes of the bus.

    Returns:
        {(priority, instance): end}.
    """
    waiting, ends, now = [], {}, -inf
    queued = sorted(queued)
    while queued or waiting:
        if not waiting:
            now = max(now, queued[0][0])
        while queued and queued[0][0] <= now:
            _, priority, instance = queued.pop(0)
            heapq.heappush(waiting, (priority, instance))
        priority, instance = waiting[0]
        heapq.heappop(waiting)
        ends[priority, instance] = now = now + lengths[priority]
    return ends
