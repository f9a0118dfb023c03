"""Interpreted, the first and the last case of a test that runs the law are enough.

That run is for coverage, which asks for every line. Whether a line is right is asked by all cases,
compiled.
"""

from collections import defaultdict

import numba
import pytest

QUICK = ("design", "discretisation")  # rooms with cheap tests


@pytest.hookimpl(trylast=True)  # after -m has chosen
def pytest_collection_modifyitems(config, items):
    """Leave out what is between, but for tests marked ``every_case``."""
    if not numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    cases = defaultdict(list)
    for item in items:
        all_of_it = item.path.parent.name in QUICK or item.get_closest_marker("every_case")
        if hasattr(item, "callspec") and not all_of_it:
            cases[item.path, item.originalname].append(item)
    left_out = {item for some in cases.values() for item in some[1:-1]}
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]
