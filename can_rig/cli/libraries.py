"""Libraries for the command line: without unused optional dependencies, and without output."""

import logging
import sys
import warnings

_NOT_WANTED = {
    "asammdf": ("can.io.mf4", "MF4Writer"),
    "coverage": ("numba.misc.coverage_support", "coverage_available"),
}
"""By name: which module imports it if it can, and what that module has once it is imported.

Asammdf brings pandas with it, most of a second that only .mf4 logs need, and ``can_rig.logs`` calls
it itself. Coverage would be told which lines numba compiles.
"""


class _WithoutThem:
    """Hides optional dependencies from a single importing module."""

    @staticmethod
    def find_spec(name: str, _path: object, _target: object = None) -> None:
        """Refuse a hidden dependency while the importing module is being imported."""
        if name not in _NOT_WANTED:
            return
        asking, has = _NOT_WANTED[name]
        importer = sys.modules.get(asking)
        if importer is not None and not hasattr(importer, has):
            raise ModuleNotFoundError(f"{name} is left out of {asking}", name=name)


def silence() -> None:
    """Silence a library's remarks on bad input; the command's own error line names the fault."""
    logging.getLogger().addHandler(logging.NullHandler())
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def leave_out() -> None:
    """Hide dependencies in this process alone; programs that import ``can_rig`` see them all."""
    sys.meta_path.insert(0, _WithoutThem)
