"""A list of faults as settings, as on the command line after ``--set``."""

from collections.abc import Mapping


def fault_list(*faults: Mapping[str, object]) -> list[str]:
    """``fault.0.kind=…`` and so on, of the keys of each fault."""
    return [
        f"fault.{at}.{key}={value}"
        for at, fault in enumerate(faults)
        for key, value in fault.items()
    ]
