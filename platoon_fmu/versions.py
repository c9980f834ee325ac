"""The versions of FMI that Vehicle.fmu is packed for: all in which they differ, apart from the C and the XML itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Version:
    """One version of the standard, as far as packing an FMU goes.

    Attributes:
        name: as a user asks for it.
        file: name of the FMU.
        face: the C file in fmi/ that has the standard's functions.
        prefix: what the names of those functions begin with.
        headers: the standard's headers.
        xml: the function of `model_description` that writes modelDescription.xml.
        image: where the FMU's picture lies besides terminalsAndIcons/, or None.
        folders: platform to the folders of binaries/ that are searched for it, where that is not the one of the
            platform's own name. Platforms that share a folder share one universal binary.
    """

    name: str
    file: str
    face: str
    prefix: str
    headers: tuple[str, ...]
    xml: str
    image: str | None = None
    folders: Mapping[str, tuple[str, ...]] = field(default_factory=dict, hash=False)

    def folders_of(self, platform: str) -> tuple[str, ...]:
        """The folders of binaries/ for a platform."""
        return self.folders.get(platform, (platform,))


FMI2 = Version(
    name="2",
    file="Vehicle.fmu",
    face="fmi2.c",
    prefix="fmi2",
    headers=("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    xml="fmi2_xml",
    image="model.png",
    # FMI 2.0.4, section 2.3: names of its own for x86, FMI 3.0's platform tuples for all else. Importers older than
    # that look on an Apple M for darwin64 as well.
    folders={
        "x86-linux": ("linux32",),
        "x86_64-linux": ("linux64",),
        "x86_64-windows": ("win64",),
        "x86_64-darwin": ("darwin64",),
        "aarch64-darwin": ("darwin64", "aarch64-darwin"),
    },
)

FMI3 = Version(
    name="3",
    file="Vehicle_FMI3.fmu",
    face="fmi3.c",
    prefix="fmi3",
    headers=("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
    xml="fmi3_xml",
)
