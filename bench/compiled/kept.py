"""Files that are made once and kept beside the machine code: a build folder's in a checkout, else the user's cache."""

import os
import tempfile
from pathlib import Path


def keep(content: bytes, file: Path) -> None:
    """Write a file whole or not at all: several processes of a run may do it at once.

    Raises:
        OSError: it cannot be written there.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=".part-")
    with os.fdopen(handle, "wb") as part:
        part.write(content)
    Path(name).replace(file)
