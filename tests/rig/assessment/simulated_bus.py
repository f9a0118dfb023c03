"""A CAN bus simulated bit by bit, to hold against the response-time analysis."""

import heapq
from math import inf


def simulate(queued, lengths, errors=()):
    """Non-pre-emptive fixed priority: when each frame that was queued is through.

    Args:
        queued: (time, priority, instance) of each, in whole units of time.
        lengths: by priority, what a frame takes of the bus.
        errors: times at which the frame on the bus is destroyed; the bus is taken for 31 more.

    Returns:
        {(priority, instance): end}.
    """
    waiting, ends, now = [], {}, -inf
    queued, errors = sorted(queued), sorted(errors)
    while queued or waiting:
        if not waiting:
            now = max(now, queued[0][0])
        while queued and queued[0][0] <= now:
            _, priority, instance = queued.pop(0)
            heapq.heappush(waiting, (priority, instance))
        priority, instance = waiting[0]
        end = now + lengths[priority]
        errors = [time for time in errors if time >= now]
        if errors and errors[0] < end:
            now = errors.pop(0) + 31
            continue
        heapq.heappop(waiting)
        ends[priority, instance] = now = end
    return ends
