"""Imports of an ECU file from its own folder, which nothing else in the process sees.

`import helper` in an ECU file, or in what it imports from its folder, finds `helper.py` or a package `helper` beside
the file; relative imports work too. The standard library, installed packages and the bench come first, so that no file
beside an ECU takes the place of one of theirs. The modules of each folder are a package of their own in `sys.modules`:
two ECUs in one process may have helpers of the same name, and nothing is added to `sys.path`.
"""

import builtins
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Mapping, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType

_PREFIX = "ecu_folder_"


def load_file(file: Path) -> ModuleType:
    """Return the module of an ECU file, imported once.

    Raises:
        FileNotFoundError: no such file.
        BaseException: whatever the file raises.
    """
    if not file.is_file():
        raise FileNotFoundError(f"no file {file}")
    file = file.resolve()
    package = importlib.import_module(_package_of(file))
    # A file's name need not be an identifier.
    name = f"{package.__name__}.{file.stem.replace('.', '_')}"
    if name in sys.modules:
        return sys.modules[name]
    loader = _Loader(name, str(file))
    module = importlib.util.module_from_spec(ModuleSpec(name, loader, origin=str(file)))
    module.__file__ = str(file)
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    return module


def shadowed(name: str, file: Path) -> Path | None:
    """Return the module `name` beside an ECU file that is not used, because one of that name exists elsewhere."""
    beside = [file.parent / f"{name}.py", file.parent / name / "__init__.py"]
    return next((path for path in beside if path.is_file()), None) if _is_elsewhere(name) else None


class _Loader(SourceFileLoader):
    """Loads a module of an ECU's folder, whose import statements also look there."""

    def exec_module(self, module: ModuleType) -> None:
        # Import statements call what the module's builtins have for them.
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": _Importer(module.__package__ or "")}
        super().exec_module(module)


class _Importer:
    """The import statement in the modules of an ECU's folder, with the signature of `__import__`."""

    def __init__(self, package: str) -> None:
        """Look in the folder, then in `package`, which is the module's own."""
        self._packages = dict.fromkeys((package.partition(".")[0], package))

    def __call__(
        self,
        name: str,
        globals_: Mapping[str, object] | None = None,
        locals_: Mapping[str, object] | None = None,
        names: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        top = name.partition(".")[0]
        package = None if level or _is_elsewhere(top) else self._package_with(top)
        if package is None:
            return builtins.__import__(name, globals_, locals_, names or (), level)
        module = builtins.__import__(f"{package}.{name}", globals_, locals_, names or (), 0)
        return module if names else sys.modules[f"{package}.{top}"]

    def _package_with(self, name: str) -> str | None:
        for package in self._packages:
            full = f"{package}.{name}"
            if full in sys.modules or importlib.util.find_spec(full) is not None:
                return package
        return None


class _Finder:
    """Finds the modules of ECUs' folders, and nothing else."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, _target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the spec of a module in an ECU's folder; None for any other."""
        if not name.startswith(_PREFIX):
            return None
        spec = PathFinder.find_spec(name, path)
        if spec is not None and isinstance(spec.loader, SourceFileLoader) and spec.origin is not None:
            spec.loader = _Loader(name, spec.origin)
        return spec


def _package_of(file: Path) -> str:
    """Return the name of the package of an ECU file: of its folder, or inside the folder of its outermost package."""
    top, inner = file.parent, list[str]()
    while (top / "__init__.py").is_file() and top.name.isidentifier():
        inner.insert(0, top.name)
        top = top.parent
    root = _PREFIX + hashlib.sha256(str(top).encode()).hexdigest()[:12]
    if root not in sys.modules:
        package = ModuleType(root)
        package.__path__ = [str(top)]
        package.__spec__ = ModuleSpec(root, None, is_package=True)
        sys.modules[root] = package
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
    return ".".join((root, *inner))


def _is_elsewhere(name: str) -> bool:
    """Whether `import name` finds a module without the folder; a folder without `__init__.py` does not count as one."""
    if name in sys.modules:
        spec = getattr(sys.modules[name], "__spec__", None)
    else:
        spec = importlib.util.find_spec(name)
        if spec is None:
            return False
    return spec is None or spec.origin is not None or spec.submodule_search_locations is None
