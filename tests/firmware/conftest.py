"""Interpreted, the first and the last case of a test are enough.

That run is for coverage, which asks for every line. Whether a line is right is asked by all cases,
compiled.
"""

from collections import defaultdict

import numba
import pytest


@pytest.hookimpl(trylast=True)  # after -m has chosen
def pytest_collection_modifyitems(config, items):
    """Leave out what is between, but for tests marked ``every_case``."""
    if not numba.config.DISABLE_JIT:
        return
    cases = defaultdict(list)
    for item in items:
        if hasattr(item, "callspec") and not item.get_closest_marker("every_case"):
            cases[item.path, item.originalname].append(item)
    left_out = {item for some in cases.values() for item in some[1:-1]}
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]
