"""Libraries as the command line wants them: without others that it has no use for, and silent."""

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
    """Hides each from the module that would import it, and from nothing else."""

    @staticmethod
    def find_spec(name: str, _path: object, _target: object = None) -> None:
        """Refuse what is not wanted while the module that asks for it is being imported."""
        if name not in _NOT_WANTED:
            return
        asking, has = _NOT_WANTED[name]
        importer = sys.modules.get(asking)
        if importer is not None and not hasattr(importer, has):
            raise ModuleNotFoundError(f"{name} is left out of {asking}", name=name)


def silence() -> None:
    """What a library has to say about bad input is in the command's own line, or of no use."""
    logging.getLogger().addHandler(logging.NullHandler())
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def leave_out() -> None:
    """Of this process alone; a program that imports ``can_rig`` has its libraries as they are."""
    sys.meta_path.insert(0, _WithoutThem)
