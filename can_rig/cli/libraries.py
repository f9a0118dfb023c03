"""Libraries as the command line wants them: python-can without asammdf, and none that prints."""

import logging
import sys
import warnings


class _WithoutAsammdf:
    """Hides asammdf from python-can, and from nothing else.

    Where asammdf is installed, ``import can`` imports it, and with it pandas: most of a second that
    only .mf4 logs need, and ``can_rig.logs`` calls asammdf itself.
    """

    @staticmethod
    def find_spec(name: str, _path: object, _target: object = None) -> None:
        """Refuse asammdf while the one module of python-can that asks for it is being imported."""
        importer = sys.modules.get("can.io.mf4")
        if name == "asammdf" and importer is not None and not hasattr(importer, "MF4Writer"):
            raise ModuleNotFoundError(f"{name} is left to can_rig.logs", name=name)


def silence() -> None:
    """What a library has to say about bad input is in the command's own line, or of no use."""
    logging.getLogger().addHandler(logging.NullHandler())
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def hide_asammdf() -> None:
    """Of this process alone; a program that imports ``can_rig`` keeps python-can as it is."""
    sys.meta_path.insert(0, _WithoutAsammdf)
