"""The metadata of a log that `platoon log recover` wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

METADATA = "recovered"
"""Name of the metadata record that a recovered log has in addition to the run's."""


@dataclass(frozen=True)
class Recovery:
    """Where a log comes from.

    Attributes:
        source: name of the damaged log.
        lost: what was lost, a sentence each.
    """

    source: str
    lost: Sequence[str]

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]]) -> Recovery | None:
        """Return the recovery described by this metadata (name -> values); None if the log was not recovered."""
        if METADATA not in metadata:
            return None
        values = metadata[METADATA]
        return cls(values.get("from", ""), values.get("lost", "").splitlines())

    @property
    def values(self) -> dict[str, str]:
        """The values of the metadata `METADATA`."""
        return {"from": self.source, "lost": "\n".join(self.lost)}
