"""The FMI versions of Vehicle.fmu: all their differences in packing, apart from the C and the XML itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Version:
    """What packing an FMU needs to know of one version of the standard.

    Attributes:
        name: as users write it.
        file: name of the FMU.
        face: the C file in fmi/ with the standard's functions.
        prefix: of the names of those functions.
        headers: the standard's headers.
        xml: the function of `model_description` that writes modelDescription.xml.
        image: path of the FMU's picture besides the one in terminalsAndIcons/, or None.
        folders: platform to its folders in binaries/, if not just the folder of the platform's name. Platforms that
            share a folder share one universal binary.
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
        """The folders in binaries/ for a platform."""
        return self.folders.get(platform, (platform,))


FMI2 = Version(
    name="2",
    file="Vehicle.fmu",
    face="fmi2.c",
    prefix="fmi2",
    headers=("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    xml="fmi2_xml",
    image="model.png",
    # FMI 2.0.4, section 2.3: FMI 2.0's own names for x86, FMI 3.0's platform tuples for all others. Older importers on
    # an Apple M also look for darwin64.
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
