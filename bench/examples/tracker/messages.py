"""Prints what the C tracker needs from the DBC besides cantools' code: data ids, timeouts, and its diagnostics.

Usage: python messages.py DBC > messages.h
"""

import sys

import cantools
from cantools.database.can import Database, Message

SENDER = "Tracker"


def attribute(message: Message, name: str) -> int:
    """Return a message's numeric attribute, or the attribute's default."""
    found = message.dbc.attributes.get(name) if message.dbc else None
    return int(found.value) if found else 0


def owed(message: Message) -> str:
    """Return a diagnostic message: identifier, cycle time (ms)."""
    return f"X(0x{message.frame_id:03X}, {message.cycle_time})"


def protected(message: Message) -> str:
    """Return a message with E2E protection: identifier, length, data id, timeout (ms; 0 if absent)."""
    timeout = attribute(message, "GenMsgTimeoutTime")
    return f"X(0x{message.frame_id:03X}, {message.length}, {attribute(message, 'E2EDataId')}, {timeout})"


def macro(name: str, entries: list[str]) -> str:
    """Return a list of entries as a C macro that applies X to each."""
    return f"#define {name}(X) \\\n    " + " \\\n    ".join(entries) + "\n"


database = cantools.database.load_file(sys.argv[1])
if not isinstance(database, Database):
    sys.exit(f"{sys.argv[1]} is not a DBC file")
messages = database.messages
sys.stdout.write("/* Generated from the DBC by messages.py. */\n")
sys.stdout.write(macro("PROTECTED_MESSAGES", [protected(m) for m in messages if attribute(m, "E2EDataId")]))
own = [m for m in messages if SENDER in m.senders and m.cycle_time and not attribute(m, "E2EDataId")]
sys.stdout.write(macro("DIAGNOSTICS", [owed(m) for m in own]))
