"""Decimation for the screen keeps every peak and invents no value."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from can_rig.drawing.thinning import Decimator

VALUES = st.floats(-1e6, 1e6) | st.just(float("nan"))


@given(
    rows=arrays(np.float64, st.tuples(st.integers(0, 60), st.just(3)), elements=VALUES),
    bucket=st.integers(2, 9),
    parts=st.lists(st.integers(0, 20), max_size=8),
)
def test_the_least_and_the_greatest_of_each_bucket_are_left(rows, bucket, parts):
    rows[:, 0] = np.arange(len(rows))
    decimator, left, at = Decimator(bucket, 3), [], 0
    for part in [*parts, len(rows)]:  # in pieces of any size
        left.append(decimator.take(rows[at : at + part]))
        at = min(at + part, len(rows))
    out = np.concatenate(left)
    whole = len(rows) // bucket
    assert out.shape == (2 * whole, 3)
    for number in range(whole):
        ours, theirs = out[2 * number : 2 * number + 2], rows[number * bucket :][:bucket]
        for column in (1, 2):
            real = theirs[~np.isnan(theirs[:, column]), column]
            if not len(real):
                assert np.isnan(ours[:, column]).all()
                continue
            assert {min(ours[:, column]), max(ours[:, column])} == {real.min(), real.max()}
            first, last = (int(np.flatnonzero(theirs[:, column] == v)[0]) for v in ours[:, column])
            assert first <= last  # in their order
        assert ours[:, 0].tolist() == [theirs[0, 0], theirs[0, 0] + bucket // 2]  # the middle row


def test_a_bucket_of_one_row_is_that_row():
    rows = np.arange(12.0).reshape(4, 3)
    assert np.array_equal(Decimator(1, 3).take(rows), rows)
