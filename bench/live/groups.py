"""How much of a log that is being written is complete.

The recorder writes chunks of some half second at once, group by group of channels: raw frames, signals, truth and so on
(`bench.mcap.chunking`). A time is complete only once all groups have been written up to it.
"""

from __future__ import annotations

from collections.abc import Collection


class ChannelGroups:
    """Which channels share chunks, learnt from the chunks, and how far each group has been written."""

    def __init__(self) -> None:
        """Begin with no group known."""
        self._group_of: dict[int, int] = {}
        self._end_ns: dict[int, int] = {}
        self._last = -1
        self._all_known = False

    def note(self, channels: Collection[int], end_ns: int) -> None:
        """Note a chunk with these channels, whose last message is at `end_ns`; noting it twice is harmless."""
        if not channels:
            return
        known = {self._group_of[channel] for channel in channels if channel in self._group_of}
        group = min(known, default=len(self._group_of))
        for old in known - {group}:
            self._end_ns[group] = max(self._end_ns[group], self._end_ns.pop(old))
            self._group_of = {channel: group if g == old else g for channel, g in self._group_of.items()}
        # Once a group comes again after others, all of them have come.
        self._all_known = self._all_known or (bool(known) and group != self._last)
        self._last = group
        self._group_of.update(dict.fromkeys(channels, group))
        self._end_ns[group] = max(self._end_ns.get(group, -1), end_ns)

    @property
    def complete_ns(self) -> int:
        """The time up to which all groups have been written, -1 where not all are known yet."""
        return min(self._end_ns.values(), default=-1) if self._all_known else -1
