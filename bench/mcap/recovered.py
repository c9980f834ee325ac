"""What a log that `platoon log recover` made says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

METADATA = "recovered"
"""Name of the metadata that a recovered log has beside those of the run."""


@dataclass(frozen=True)
class Recovery:
    """Where a log comes from.

    Attributes:
        source: name of the broken log.
        lost: what was lost, a sentence each.
    """

    source: str
    lost: Sequence[str]

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]]) -> Recovery | None:
        """Return what a log with this metadata (name -> values) says; None where it was not recovered."""
        if METADATA not in metadata:
            return None
        values = metadata[METADATA]
        return cls(values.get("from", ""), values.get("lost", "").splitlines())

    @property
    def values(self) -> dict[str, str]:
        """The values of the metadata `METADATA`."""
        return {"from": self.source, "lost": "\n".join(self.lost)}
