"""``import can`` without asammdf, for the command line, which asks asammdf itself where it must."""

import sys


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


def hide_asammdf() -> None:
    """Of this process alone; a program that imports ``can_rig`` keeps python-can as it is."""
    sys.meta_path.insert(0, _WithoutAsammdf)
