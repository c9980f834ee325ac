"""What a run's result depends on besides its scenario: the code and data of the bench, and packages that compute."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from bench.bus.codec import DBC_DIR

PACKAGES = ("platoon", "numpy", "scipy", "clarabel", "cython", "mcap", "pydantic", "dask", "distributed")
"""Packages that must have the same version on all machines of a campaign."""

_ROOT = Path(__file__).resolve().parents[2]
_SUFFIXES = {".py", ".pxd", ".toml", ".dbc", ".c", ".h"}
_OF_A_RUN = ("bench/campaign/one_run.py", "bench/campaign/requirements.py", "bench/campaign/study.py")
_NOT_OF_A_RUN = ("bench/benchmarks", "bench/cli", "bench/live", "bench/analysis/page", "bench/campaign", "bench/dbc")


@cache
def code_version() -> str:
    """Return a hash of all code and data that a run's result depends on, the same in a checkout and installed."""
    digest = hashlib.sha256()
    for top in ("bench", "platoon_fmu"):
        for path in sorted((_ROOT / top).rglob("*")):
            name = path.relative_to(_ROOT).as_posix()
            if path.suffix in _SUFFIXES and (name in _OF_A_RUN or not name.startswith(_NOT_OF_A_RUN)):
                digest.update(name.encode() + b"\0" + path.read_bytes())
    for path in sorted(DBC_DIR.glob("*.dbc")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def versions() -> dict[str, str]:
    """Return what must be the same on all machines of a campaign: code, Python, kind of machine and packages."""
    return {
        "code": code_version(),
        "python": platform.python_version(),
        "machine": f"{sys.platform} {platform.machine()}",
        **{name: version(name) for name in PACKAGES},
    }


def difference(wanted: Mapping[str, str], have: Mapping[str, str]) -> str:
    """Return how versions differ from those wanted, as the end of a sentence; empty if they do not."""
    differing = [
        f"{name} {have.get(name)} instead of {each}" for name, each in wanted.items() if have.get(name) != each
    ]
    return f"has {', '.join(differing)}" if differing else ""
