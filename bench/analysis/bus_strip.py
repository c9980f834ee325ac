"""A picture of one cycle on each bus as SVG: when each frame was on the wire, and how long it had waited."""

from __future__ import annotations

import html
from collections.abc import Sequence

from bench.analysis.bus_load import BusLoad, SentFrame
from bench.bus.link.base import EXTENDED
from bench.cycle import CYCLE_MS
from bench.names import CONDUCTOR, PLANT

_LEFT, _RIGHT, _TOP = 58.0, 12.0, 24.0
_WIDTH, _ROW, _BAR = 1120.0, 30.0, 16.0
_COLOURS = {CONDUCTOR: "#8a8a8a", PLANT: "#009e73", "planner": "#0072b2", "tracker": "#d55e00", "others": "#c8102e"}
_STYLE = (
    ".strip text{font:12px system-ui,sans-serif;fill:#808080}.strip .tick{stroke:#80808050}"
    ".strip .wait{stroke-width:1.5;stroke-opacity:.55}"
)


def strip(buses: Sequence[BusLoad]) -> str:
    """Return the busiest cycle of each bus as an SVG element: a bar for each frame, a line for its waiting time."""
    last_ms = max(float(CYCLE_MS), *(1e3 * frame.end_s for bus in buses for frame in bus.busiest))
    scale = (_WIDTH - _LEFT - _RIGHT) / last_ms
    height = _TOP + len(buses) * _ROW + 34.0
    bottom = _TOP + len(buses) * _ROW
    step = max(1, round(last_ms / 12))
    marks = [
        f'<path class="tick" d="M{_LEFT + ms * scale:.1f} {_TOP}V{bottom}"/>'
        f'<text x="{_LEFT + ms * scale:.1f}" y="{bottom + 14}" text-anchor="middle">{ms}</text>'
        for ms in range(0, int(last_ms) + 1, step)
    ]
    middle = _LEFT + (_WIDTH - _LEFT) / 2
    marks.append(f'<text x="{middle:.1f}" y="{bottom + 30}" text-anchor="middle">time in the cycle [ms]</text>')
    rows = []
    for row, bus in enumerate(buses):
        y = _TOP + row * _ROW + (_ROW - _BAR) / 2
        rows.append(f'<text x="0" y="{y + 12:.1f}">{html.escape(bus.bus)}</text>')
        rows += [_frame(frame, y, scale) for frame in bus.busiest]
    box = f"0 0 {_WIDTH:.0f} {height:.0f}"
    return (
        f'<svg class="strip" xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img">'
        f"<title>The busiest cycle of each bus</title><style>{_STYLE}</style>{_legend()}{''.join(marks + rows)}</svg>"
    )


def _frame(frame: SentFrame, y: float, scale: float) -> str:
    colour = _COLOURS[_role(frame.sender)]
    release, start, end = (_LEFT + 1e3 * time * scale for time in (frame.release_s, frame.start_s, frame.end_s))
    digits = 8 if frame.can_id & EXTENDED else 3
    name = html.escape(f"{frame.name or 'not in the DBC'} (0x{frame.can_id & ~EXTENDED:0{digits}X})")
    text = (
        f"{name}: {1e3 * frame.start_s:.3f} to {1e3 * frame.end_s:.3f} ms, "
        f"{1e3 * (frame.start_s - frame.release_s):.3f} ms after it was released"
    )
    bar = f'<rect x="{start:.2f}" y="{y}" width="{max(0.5, end - start - 0.6):.2f}" height="{_BAR}" fill="{colour}"/>'
    below = y + _BAR + 3.0
    wait = f'<path class="wait" stroke="{colour}" d="M{release:.2f} {below}H{start:.2f}"/>'
    return f"<g><title>{text}</title>{bar}{wait}</g>"


def _role(sender: str) -> str:
    role = sender.rpartition(".")[2]
    return role if role in _COLOURS else "others"


def _legend() -> str:
    parts, x = [], _LEFT
    for name, colour in _COLOURS.items():
        parts.append(
            f'<rect x="{x}" y="2" width="12" height="12" fill="{colour}"/><text x="{x + 17}" y="12">{name}</text>'
        )
        x += 32 + 7.0 * len(name)
    return "".join(parts)
