"""The rig: a simulated plant and the controller as two processes that exchange CAN frames."""

import sys


class _LightPythonCan:
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


sys.meta_path.insert(0, _LightPythonCan)
