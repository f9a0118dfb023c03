"""A class or function of the user's, by its import path: found, called, its failures in a line."""

import importlib
import inspect
import math
import sys
import traceback
from collections.abc import Callable
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

from can_rig.errors import RigError, ScenarioError, one_line

Answer = TypeVar("Answer")
MAIN = "__main__"
PACKAGE = str(Path(__file__).parents[1])


def _is_packaged(file: str) -> bool:
    """Whether a file is of an installed package, of this one or of Python."""
    return file.startswith((PACKAGE, "<")) or "site-packages" in file or "/lib/python3" in file


class _Function:
    """A function in place of a class: no settings, and nothing to reset."""

    def __init__(self, settings: object) -> None:
        pass

    def reset(self, *_: object) -> None:
        pass


def _split(path: str) -> tuple[Path, str, str]:
    """Folder, module and class of ``FOLDER/package.module:Class``."""
    file, _, name = path.rpartition(":")
    return Path(file).parent, Path(file).name.removesuffix(".py"), name


def is_class_path(text: str) -> bool:
    """Whether ``text`` reads ``FOLDER/package.module:Class``; folder and class need not exist."""
    _, module, name = _split(text)
    return all(part.isidentifier() for part in (name, *module.split(".")))


def module_file(path: str) -> Path:
    """The file of the module in a class path. An installed package has no such file."""
    folder, module, _ = _split(path)
    return folder / f"{module.replace('.', '/')}.py"


def path_of(module: str, name: str) -> str:
    """``FOLDER/module:Name`` of the class ``name``; a script's module is the script's file."""
    script = _script().with_suffix("")
    of_script = f"{script.name if script.parent == Path.cwd() else script}:{name}"
    is_script = module == MAIN and is_class_path(of_script)
    return of_script if is_script else f"{module}:{name}"


def _script() -> Path:
    """The file that Python runs; the current folder where there is none, as in a notebook."""
    return Path(getattr(sys.modules[MAIN], "__file__", None) or "").resolve()


def seen_from(folder: Path, path: str) -> str:
    """The class ``path`` of a file in ``folder``, for a search from the current directory."""
    inner, module, _ = _split(path)
    there = folder / inner / module.replace(".", "/")
    is_there = there.is_dir() or Path(f"{there}.py").is_file()
    return str(folder / path) if is_there or "/" in path else path


def find_class(where: str, path: str, method: str) -> type[object]:
    """The class at ``FOLDER/package.module:Class``, or of an installed package.

    Args:
        where: begins an error's line, as in ``plant.kind = 'mycar:Lag'``.
        path: the class; or a function, which becomes a class with the function as its only method
            of effect. Without a folder, the current directory.
        method: this method's name.

    Raises:
        ScenarioError: no such module or class, a module that cannot be imported, or a folder's
            module that another module of the same name hides.
    """
    folder, module_name, class_name = _split(path)
    here = str(folder.resolve())
    if here not in sys.path:
        sys.path.append(here)  # last: no stray file hides an installed package
    importlib.invalidate_caches()
    mine = Path(here) / module_file(path).relative_to(folder)
    if mine.resolve() == _script():
        module_name = MAIN
    try:
        module = importlib.import_module(module_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and f"{module_name}.".startswith(f"{missing}."):  # not an import of the module
            raise ScenarioError(
                f"{where}: no module {missing}, neither installed nor in {here}"
            ) from None
        raise ScenarioError(failure(where, f"{module_name} cannot be imported", error)) from None
    found = getattr(module, class_name, None)
    file = getattr(module, "__file__", None) or module_name
    is_other = mine.is_file() and mine.resolve() != Path(file).resolve()
    hidden = f", which hides {mine}: rename that file" if is_other else ""
    if hidden and "/" in path:
        raise ScenarioError(f"{where}: {module_name} is {file}{hidden}")
    if inspect.isfunction(found):
        return type(class_name, (_Function,), {method: staticmethod(found)})
    if not inspect.isclass(found):
        raise ScenarioError(f"{where}: no class or function {class_name} in {file}{hidden}")
    return found


def as_float(value: Any) -> float:
    """A number, or an array of shape (), as a float; nan for anything else."""
    number = value.item() if getattr(value, "shape", None) == () else value
    try:
        return float(number) if isinstance(number, Real) else math.nan
    except OverflowError:
        return math.nan


def failure(where: str, what: str, error: BaseException) -> str:
    """One line for an exception in code of the user's, with the file and the line."""
    frames = traceback.extract_tb(error.__traceback__)
    theirs = [frame for frame in frames if not _is_packaged(frame.filename)]
    at = f" ({theirs[-1].filename}, line {theirs[-1].lineno})" if theirs else ""
    # its own text may fail too
    reason = " ".join(str(traceback.TracebackException(type(error), error, None)).split())
    return f"{where}: {what}: {type(error).__name__}" + (reason and f": {reason}") + at


def guard(
    where: str, what: str, call: Callable[[], Answer], refusal: type[RigError] = ScenarioError
) -> Answer:
    """Return the result of ``call``; report an exception, also ``sys.exit``, in one line."""
    try:
        return call()
    except KeyboardInterrupt:
        raise
    except RigError as error:
        raise refusal(f"{where}: {what}: {one_line(error)}") from None
    except BaseException as error:
        raise refusal(failure(where, what, error)) from None


def require_signature(
    where: str, function: Callable[..., object], name: str, right: str, *arguments: object
) -> None:
    """Refuse a signature that rejects ``arguments`` by position; it must be ``right``."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # compiled code without a signature: the trial decides
        return
    try:
        signature.bind(*arguments)
    except TypeError:
        raise ScenarioError(f"{where}: {name}{signature}: must be {right}") from None
